// Voxels from a height field: the share of each voxel that lies under the ground (orograph.lighting.gpu.cone_tracing).

struct Level {
    origin: vec4i,  // of the level's voxels in its own units: columns, rows, layers; level
    size: vec4u,    // voxels along columns, rows, layers; the level of the samples
    ground: vec4i,  // of the samples: first column and row, columns, rows
    height: vec4f,  // of a voxel of level 0, metres; the base of layers
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

// The height in the middle of one of the four quarters of a sample's area, from the surrounding samples that
// exist. Sample i of level m stands for 2^m columns from i 2^m − 1/2 on.
fn between(at: vec2i, side: vec2i) -> f32 {
    let offset = vec2f(side) * 0.25 + 0.5 - exp2(-1.0 - f32(level.size.w));
    let base = at + vec2i(floor(offset));
    let f = offset - floor(offset);
    let a = height(base);
    let b = height(base + vec2i(1, 0));
    let c = height(base + vec2i(0, 1));
    let d = height(base + vec2i(1, 1));
    if (min(min(a, b), min(c, d)) < 0.5 * MISSING) {
        // Beyond the terrain's border there is none, although its last coarse sample may lie there.
        let place = (vec2f(at) + offset) * exp2(f32(level.size.w));
        let own = select(height(at), MISSING, any(place > vec2f(level.last.xy) + 0.5));
        return select(own - level.height.y, MISSING, own < 0.5 * MISSING);
    }
    return mix(mix(a, b, f.x), mix(c, d, f.x), f.y) - level.height.y;
}

// How much of four consecutive layers lies under a height, in layers above the bottom of the first.
fn under(h: f32) -> vec4f {
    return clamp(vec4f(h) - vec4f(0.0, 1.0, 2.0, 3.0), vec4f(0.0), vec4f(1.0));
}

// One invocation per column of voxels: each of the samples under it is four quarters, whose heights fill layers. Along
// columns (or rows), the highest of the quarters one behind the other hides: the mean of those counts. Layers below
// all of the samples are full and those above them empty; quarters are examined for the few in between.
@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= level.size.x || id.y >= level.size.y) {
        return;
    }
    let wide = 1 << (u32(level.origin.w) - level.size.w);
    let first = (vec2i(id.xy) + level.origin.xy) * wide;
    let thick = level.height.x * exp2(f32(level.origin.w));
    let layers = f32(level.size.z);
    // In layers above the first: interpolated between two samples, also in height.
    let bottom = f32(level.origin.z) + level.height.y / thick;
    var lowest = 1e30;
    var highest = MISSING;
    for (var row = -1; row <= wide; row++) {
        for (var col = -1; col <= wide; col++) {
            let h = height(first + vec2i(col, row));
            lowest = min(lowest, h);
            highest = max(highest, h);
        }
    }
    if (any(vec2f(first + wide) * exp2(f32(level.size.w)) > vec2f(level.last.xy) + 0.5)) {
        lowest = MISSING;  // some of it lies beyond the terrain's border
    }
    let full = u32(clamp(floor(lowest / thick - bottom) - 0.01, 0.0, layers));
    let end = u32(clamp(ceil(highest / thick - bottom) + 0.01, 0.0, layers));
    let place = level.place.xyz + vec3i(vec2i(id.xy), 0);
    for (var k = 0u; k < full; k++) {
        textureStore(voxels, place + vec3i(0, 0, i32(k)), vec4f(1.0, 1.0, 1.0, 0.0));
    }
    let part = 1.0 / f32(2 * wide);
    var k0 = full;
    for (; k0 < end; k0 += 4u) {
        let base = f32(level.origin.z) + f32(k0);
        var along = vec4f(0.0);
        var across = vec4f(0.0);
        var filled = vec4f(0.0);
        for (var line = 0; line < 2 * wide; line++) {
            var row = MISSING;
            var col = MISSING;
            let side = select(-1, 1, (line & 1) == 1);
            for (var i = 0; i < 2 * wide; i++) {
                let other = select(-1, 1, (i & 1) == 1);
                let h = between(first + vec2i(i >> 1u, line >> 1u), vec2i(other, side));
                row = max(row, h);
                filled += under(h / thick - base);
                col = max(col, between(first + vec2i(line >> 1u, i >> 1u), vec2i(side, other)));
            }
            along += under(row / thick - base);
            across += under(col / thick - base);
        }
        for (var k = 0u; k < min(4u, level.size.z - k0); k++) {
            textureStore(voxels, place + vec3i(0, 0, i32(k0 + k)), vec4f(along[k] * part, across[k] * part, filled[k] * part * part, 0.0));
        }
    }
    for (var k = k0; k < level.size.z; k++) {
        textureStore(voxels, place + vec3i(0, 0, i32(k)), vec4f(0.0));
    }
}
