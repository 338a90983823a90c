// Ambient occlusion by one shadow map per direction (orograph.lighting.gpu.occlusion_maps has the idea, source and units).
//
// Three stages per direction ω: the height field is rasterised along ω (vertex, fragment) into a map of layers: each
// texel is a sorted list of the depths of all faces that look away from the light; then every sample finds the first of
// them in front of it, which is where its ray enters the ground, and adds ρ of the distance (gather).

struct Direction {
    u: vec4f,       // texel column of a point (x, y, z, 1): samples, samples, metres, from the tile's first sample
    v: vec4f,       // texel row
    s: vec4f,       // metres away from the light: smaller is nearer to it
    omega: vec4f,   // east, north, up; weight 1 / density
    run: vec4f,     // samples per metre along ω: columns, rows; R in metres; 1 if ρ is a step
    map: vec4u,     // width, height and layers of the map; 1 if front faces are in it as well
    tile: vec4i,    // first column and row of the receivers in the finest ring; their columns and rows
    bias: vec4f,    // metres: nearest back face, nearest front face that count; width of a texel; 0
};

struct Ring {
    origin: vec4i,  // its first column and row, in samples of the terrain from the tile's first; its level
    last: vec4i,    // the terrain's last column and row, likewise; its own columns and rows
    hole: vec4i,    // in its own columns and rows: the area that a finer ring draws (left, top, right, bottom)
    drop: vec4f,    // metres by which its surface falls within the hole; the height that heights are relative to
};

@group(0) @binding(0) var<uniform> d: Direction;  // dynamic
@group(0) @binding(1) var<storage, read> heights: array<f32>;       // of the ring, metres; MISSING
@group(0) @binding(2) var<storage, read_write> layers: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> sums: array<vec2f>;  // per receiver Σ w ρ, Σ w
@group(0) @binding(4) var<storage, read> gradient: array<vec2f>;    // per receiver, rise per metre east and north
@group(0) @binding(5) var<storage, read> table: array<f32>;
@group(0) @binding(6) var<storage, read_write> lost: array<atomic<u32>>;  // number of faces without a free layer
@group(0) @binding(7) var<uniform> ring: Ring;

// include: rho.wgsl

const MISSING = -1e30;

fn height(col: i32, row: i32) -> f32 {
    if (col < 0 || row < 0 || col >= ring.last.z || row >= ring.last.w) {
        return MISSING;
    }
    let h = heights[row * ring.last.z + col];
    return select(h - ring.drop.y, MISSING, h < 0.5 * MISSING);
}

// A point of the ring: columns and rows of the terrain from the tile's first sample, metres. Beyond the terrain's border
// coarse samples repeat those on it.
fn point(at: vec2i, z: f32) -> vec4f {
    let place = min(ring.origin.xy + (at << vec2u(u32(ring.origin.z))), ring.last.xy);
    let within = all(at > ring.hole.xy) && all(at < ring.hole.zw);
    return vec4f(vec2f(place), z - select(0.0, ring.drop.x, within), 1.0);
}

// Unsigned numbers in the order of floats of either sign, none of them 0; and the inverse.
fn ordered(x: f32) -> u32 {
    let bits = bitcast<u32>(x);
    return select(bits | 0x80000000u, ~bits, (bits >> 31u) == 1u);
}

fn unordered(key: u32) -> f32 {
    return bitcast<f32>(select(~key, key & 0x7fffffffu, (key >> 31u) == 1u));
}

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) s: f32,
    @location(1) gone: f32,  // 1 if the sample is missing
};

// An instance is a block of 16 × 16 cells of the ring, of which those between its clips are drawn: the others
// collapse. block: its first column and row; the clips, 8 bits each: first column and end, first row and end.
@vertex
fn vertex(@builtin(vertex_index) index: u32, @location(0) block: vec4i) -> Corner {
    let clip = (vec4u(u32(block.z)) >> vec4u(0u, 8u, 16u, 24u)) & vec4u(255u);
    let at = block.xy + vec2i(clamp(vec2u(index % 17u, index / 17u), clip.xz, clip.yw));
    let h = height(at.x, at.y);
    let there = h > 0.5 * MISSING;
    let p = point(at, select(0.0, h, there));
    let texel = vec2f(dot(d.u, p), dot(d.v, p));
    var out: Corner;
    out.position = vec4f(texel.x * 2.0 / f32(d.map.x) - 1.0, 1.0 - texel.y * 2.0 / f32(d.map.y), 0.5, 1.0);
    out.s = dot(d.s, p);
    out.gone = select(1.0, 0.0, there);
    return out;
}

// Keep the depths of a texel sorted, largest first, whatever the order in which faces arrive: each slot ends up with
// the largest of those passed to it (Liu et al. 2009, multi-layer depth by atomic minima). 0 is empty. The last bit says
// whether the face looks towards the light.
@fragment
fn fragment(in: Corner, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    if (in.gone > 1e-4) {  // a corner is missing: a hole
        return vec4f(0.0);
    }
    let texel = vec2u(in.position.xy);
    let first = (texel.y * d.map.x + texel.x) * d.map.z;
    var value = (ordered(in.s) & 0xfffffffeu) | select(0u, 1u, front && d.map.w == 1u);
    for (var k = 0u; k < d.map.z; k++) {
        let old = atomicMax(&layers[first + k], value);
        value = min(old, value);
        if (value == 0u) {
            return vec4f(0.0);
        }
    }
    atomicAdd(&lost[0], 1u);
    return vec4f(0.0);
}

// Whether the ray begins under one of the facets that meet in its own sample: these are known without a map.
fn buried(col: i32, row: i32, z: f32) -> bool {
    let run = abs(d.run.xy);
    let sx = select(-1, 1, d.run.x >= 0.0);
    let sy = select(-1, 1, d.run.y >= 0.0);
    var rise: f32;
    if (((col + row) & 1) == 0) {  // eight facets, each between a neighbour along an axis and a diagonal one
        let far = height(col + sx, row + sy);
        let wide = run.x >= run.y;
        let near = select(height(col, row + sy), height(col + sx, row), wide);
        if (min(far, near) < 0.5 * MISSING) {
            return false;
        }
        rise = (near - z) * abs(run.x - run.y) + (far - z) * min(run.x, run.y);
    } else {  // four, between neighbours along the axes
        let x = height(col + sx, row);
        let y = height(col, row + sy);
        if (min(x, y) < 0.5 * MISSING) {
            return false;
        }
        rise = (x - z) * run.x + (y - z) * run.y;
    }
    return d.omega.z < rise;
}

@compute @workgroup_size(8, 8)
fn gather(@builtin(global_invocation_id) id: vec3u) {
    if (i32(id.x) >= d.tile.z || i32(id.y) >= d.tile.w) {
        return;
    }
    let index = id.y * u32(d.tile.z) + id.x;
    let col = d.tile.x + i32(id.x);
    let row = d.tile.y + i32(id.y);
    let z = height(col, row);
    let g = gradient[index];
    if (z < 0.5 * MISSING) {
        return;
    }
    let cosine = (d.omega.z - dot(g, d.omega.xy)) * inverseSqrt(1.0 + dot(g, g));
    let weight = d.omega.w * cosine;
    if (weight <= 0.0) {
        return;
    }
    let radius = d.run.z;
    let step = d.run.w == 1.0;
    var through = rho_free();
    if (buried(col, row, z)) {
        through = select(table[0], 0.0, step);
    } else {
        let p = point(vec2i(col, row), z);
        let s = dot(d.s, p);
        let texel = clamp(vec2i(floor(vec2f(dot(d.u, p), dot(d.v, p)))), vec2i(0), vec2i(d.map.xy) - 1);
        let first = (u32(texel.y) * d.map.x + u32(texel.x)) * d.map.z;
        // A ray through the texel's middle may begin under its own ground and emerge at a grazing angle.
        let front = d.bias.y + d.bias.z / cosine;
        for (var k = 0u; k < d.map.z; k++) {
            let bits = atomicLoad(&layers[first + k]);
            if (bits == 0u) {
                break;
            }
            let length = s - unordered(bits & 0xfffffffeu);
            if (length > select(d.bias.x, front, (bits & 1u) == 1u)) {
                if (length < radius) {
                    if (step) {
                        through = 0.0;
                    } else {
                        through = rho(length, radius);
                    }
                }
                break;
            }
        }
    }
    sums[index] += weight * vec2f(through, 1.0);
}
