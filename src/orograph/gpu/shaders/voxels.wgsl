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

// One invocation per column of voxels: each of the samples under it is four quarters, whose heights fill layers. Seen along
// columns (or rows) what hides is the highest of the quarters that lie one behind the other: the mean of those.
@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= level.size.x || id.y >= level.size.y) {
        return;
    }
    let wide = 1 << u32(level.origin.w);
    let first = (vec2i(id.xy) + level.origin.xy) * wide;
    let thick = level.height.x * f32(wide);
    let bottom = level.height.y + f32(level.origin.z) * thick;
    let part = 1.0 / f32(2 * wide);
    for (var k0 = 0u; k0 < level.size.z; k0 += 16u) {
        var along: array<f32, 16>;
        var across: array<f32, 16>;
        var filled: array<f32, 16>;
        for (var k = 0; k < 16; k++) {
            along[k] = 0.0;
            across[k] = 0.0;
            filled[k] = 0.0;
        }
        for (var line = 0; line < 2 * wide; line++) {
            var row = MISSING;
            var col = MISSING;
            let side = select(-1, 1, (line & 1) == 1);
            for (var i = 0; i < 2 * wide; i++) {
                let other = select(-1, 1, (i & 1) == 1);
                let h = between(first.x + (i >> 1u), first.y + (line >> 1u), vec2i(other, side));
                row = max(row, h);
                for (var k = 0; k < 16; k++) {
                    filled[k] += clamp((h - bottom) / thick - f32(k0) - f32(k), 0.0, 1.0) * part * part;
                }
                col = max(col, between(first.x + (line >> 1u), first.y + (i >> 1u), vec2i(side, other)));
            }
            for (var k = 0; k < 16; k++) {
                along[k] += clamp((row - bottom) / thick - f32(k0) - f32(k), 0.0, 1.0) * part;
                across[k] += clamp((col - bottom) / thick - f32(k0) - f32(k), 0.0, 1.0) * part;
            }
        }
        for (var k = 0; k < 16; k++) {
            if (k0 + u32(k) < level.size.z) {
                textureStore(voxels, vec3i(vec2i(id.xy), i32(k0) + k), vec4f(along[k], across[k], filled[k], 0.0));
            }
        }
    }
}
