// Voxels out of a height field: the share of each voxel that lies under the ground (orograph.gpu.cone_tracing).

struct Level {
    origin: vec4i,  // of the level's voxels in its own units: columns, rows, layers; level
    size: vec4u,    // voxels along columns, rows, layers; the level of the samples
    ground: vec4i,  // of the samples: first column and row, columns, rows
    height: vec4f,  // of a voxel of level 0, metres; what layers count from
    last: vec4i,    // the terrain's last column and row at full resolution
    place: vec4i,   // of the level's first voxel in the texture of all levels
};

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> heights: array<f32>;
@group(0) @binding(2) var voxels: texture_storage_3d<rgba8unorm, write>;

const MISSING = -1e30;

fn height(at: vec2i) -> f32 {
    let k = at - level.ground.xy;
    if (any(k < vec2i(0)) || any(k >= level.ground.zw)) {
        return MISSING;
    }
    return heights[k.y * level.ground.z + k.x];
}

// The height in the middle of one of the four quarters of what a sample stands for, from the samples around that are
// there. Sample i of level m stands for 2^m columns from i 2^m − 1/2 on.
fn between(at: vec2i, side: vec2i) -> f32 {
    let offset = vec2f(side) * 0.25 + 0.5 - exp2(-1.0 - f32(level.size.w));
    let base = at + vec2i(floor(offset));
    let f = offset - floor(offset);
    let a = height(base);
    let b = height(base + vec2i(1, 0));
    let c = height(base + vec2i(0, 1));
    let d = height(base + vec2i(1, 1));
    if (min(min(a, b), min(c, d)) < 0.5 * MISSING) {
        // Beyond the terrain's border there is none, though its last coarse sample may stand there.
        let place = (vec2f(at) + offset) * exp2(f32(level.size.w));
        let own = select(height(at), MISSING, any(place > vec2f(level.last.xy) + 0.5));
        return select(own - level.height.y, MISSING, own < 0.5 * MISSING);
    }
    return mix(mix(a, b, f.x), mix(c, d, f.x), f.y) - level.height.y;
}

// One invocation per column of voxels: each of the samples under it is four quarters, whose heights fill layers. Seen along
// columns (or rows) what hides is the highest of the quarters that lie one behind the other: the mean of those.
@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= level.size.x || id.y >= level.size.y) {
        return;
    }
    let wide = 1 << (u32(level.origin.w) - level.size.w);
    let first = (vec2i(id.xy) + level.origin.xy) * wide;
    let thick = level.height.x * exp2(f32(level.origin.w));
    let bottom = f32(level.origin.z) * thick;
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
                let h = between(first + vec2i(i >> 1u, line >> 1u), vec2i(other, side));
                row = max(row, h);
                for (var k = 0; k < 16; k++) {
                    filled[k] += clamp((h - bottom) / thick - f32(k0) - f32(k), 0.0, 1.0) * part * part;
                }
                col = max(col, between(first + vec2i(line >> 1u, i >> 1u), vec2i(side, other)));
            }
            for (var k = 0; k < 16; k++) {
                along[k] += clamp((row - bottom) / thick - f32(k0) - f32(k), 0.0, 1.0) * part;
                across[k] += clamp((col - bottom) / thick - f32(k0) - f32(k), 0.0, 1.0) * part;
            }
        }
        for (var k = 0; k < 16; k++) {
            if (k0 + u32(k) < level.size.z) {
                textureStore(voxels, level.place.xyz + vec3i(vec2i(id.xy), i32(k0) + k), vec4f(along[k], across[k], filled[k], 0.0));
            }
        }
    }
}
