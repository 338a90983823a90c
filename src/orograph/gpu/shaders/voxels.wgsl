// Voxels out of a height field: the share of each voxel that lies under the ground (orograph.gpu.cone_tracing).

struct Level {
    origin: vec4i,  // of the level's voxels in its own units: columns, rows, layers; level
    size: vec4u,    // voxels along columns, rows, layers
    ground: vec4i,  // of the heights: first column and row (full resolution), columns, rows
    height: vec4f,  // of a voxel of level 0, metres; what layers count from, metres relative to the heights
};

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> heights: array<f32>;
@group(0) @binding(2) var voxels: texture_storage_3d<rgba8unorm, write>;

const MISSING = -1e30;

fn height(col: i32, row: i32) -> f32 {
    let at = vec2i(col, row) - level.ground.xy;
    if (any(at < vec2i(0)) || any(at >= level.ground.zw)) {
        return MISSING;
    }
    return heights[at.y * level.ground.z + at.x];
}

// A height between samples (quarter points of the cells around), from those that are there.
fn between(col: i32, row: i32, side: vec2i) -> f32 {
    let h = height(col, row);
    let x = height(col + side.x, row);
    let y = height(col, row + side.y);
    let xy = height(col + side.x, row + side.y);
    if (min(min(h, x), min(y, xy)) < 0.5 * MISSING) {
        return h;
    }
    return 0.5625 * h + 0.1875 * (x + y) + 0.0625 * xy;
}

// One invocation per column of voxels: each of the samples under it is four quarters, whose heights fill layers.
@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= level.size.x || id.y >= level.size.y) {
        return;
    }
    let wide = 1 << u32(level.origin.w);
    let first = (vec2i(id.xy) + level.origin.xy) * wide;
    let thick = level.height.x * f32(wide);
    let bottom = level.height.y + f32(level.origin.z) * thick;
    let share = 1.0 / f32(4 * wide * wide);
    for (var k0 = 0u; k0 < level.size.z; k0 += 16u) {
        var filled: array<f32, 16>;
        for (var k = 0; k < 16; k++) {
            filled[k] = 0.0;
        }
        for (var j = 0; j < wide; j++) {
            for (var i = 0; i < wide; i++) {
                for (var q = 0; q < 4; q++) {
                    let side = vec2i(select(-1, 1, (q & 1) == 1), select(-1, 1, q >= 2));
                    let h = between(first.x + i, first.y + j, side);
                    let layers = (h - bottom) / thick - f32(k0);
                    for (var k = 0; k < 16; k++) {
                        filled[k] += clamp(layers - f32(k), 0.0, 1.0) * share;
                    }
                }
            }
        }
        for (var k = 0; k < 16; k++) {
            if (k0 + u32(k) < level.size.z) {
                textureStore(voxels, vec3i(vec2i(id.xy), i32(k0) + k), vec4f(filled[k], 0.0, 0.0, 0.0));
            }
        }
    }
}
