// Ambient occlusion by tracing cones through voxels (orograph.lighting.gpu.cone_tracing has the idea, source and units).

struct Level {
    origin: vec4f,  // voxels, of the level's own size: columns, rows, layers; thickness in metres
    size: vec4f,    // voxels
    place: vec4f,   // of its first voxel in the texture of all levels
};

struct Frame {
    linear: vec4f,   // metres east and north per column, per row
    inverse: vec4f,  // columns, rows per metre east; per metre north
    run: vec4f,      // metres of a voxel of level 0, R, width of a voxel in widths of the cone, first distance in voxels
    tile: vec4i,     // first column and row, columns, rows
    counts: vec4i,   // cones, levels, 1 for a step, samples around the tile that heights include
    levels: array<Level, 12>,
};

struct Cone {
    axis: vec4f,     // about the normal: along columns, along rows, along the normal; share of the cosine's integral
    band: vec4f,     // elevations of its patch above the ground's plane, lowest and highest; tangent of its half angle
};

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> heights: array<f32>;  // tile and border, metres above the base of layers
@group(0) @binding(2) var<storage, read> gradient: array<vec2f>;
@group(0) @binding(3) var<storage, read> cones: array<Cone>;
@group(0) @binding(4) var<storage, read> table: array<f32>;
@group(0) @binding(5) var<storage, read_write> result: array<f32>;
@group(0) @binding(6) var linear_sampler: sampler;
@group(0) @binding(7) var voxels: texture_3d<f32>;

// include: rho.wgsl

const MISSING = -1e30;
const NEAR = 0.5;  // cells: first distance at which the ground itself is examined
const FARTHER = 1.3;  // factor between these distances
// Where the filled share of voxels rises along the cone from one step to the next, what a voxel hides counts instead of
// its filled share: not if the share rises by less than FLAT, wholly if it rises by FLAT + EDGE. Along a slope that the
// cone grazes the share stays the same, and the highest ground in a voxel hides nothing; before a cliff it rises.
const FLAT = 0.03;
const EDGE = 0.067;

// For a level's voxel at a point (columns, rows, metres): the shares hidden along columns, along rows, and filled; trilinear.
fn share_of(level: i32, p: vec3f) -> vec3f {
    let l = frame.levels[level];
    let wide = f32(1 << u32(level));
    let at = vec3f((p.xy + 0.5) / wide, p.z / l.origin.w) - l.origin.xyz;
    let uvw = (l.place.xyz + clamp(at, vec3f(0.5), l.size.xyz - 0.5)) / vec3f(textureDimensions(voxels));
    return textureSampleLevel(voxels, linear_sampler, uvw, 0.0).xyz;
}

// The shares of the sample's own tangent plane in a filter of width d, at a height s above it: normal law with
// the variance of a box and a tent (d² / 12 + d² / 6) along each axis. Along the viewing axis the box is as
// high as its highest side; g: the plane's slopes, metres per metre along columns and rows.
fn plane_share(s: f32, d: f32, g: vec2f) -> vec3f {
    let square = g * g;
    let all = 1.0 + square.x + square.y;
    let spread = vec3f(vec2f(all) - square / 3.0, all);
    let x = (vec3f(s) - vec3f(abs(g), 0.0) * 0.5 * d) / (0.5 * d * sqrt(spread));
    // Φ(−x) by the logistic law's tangent form (Page 1977), within 2e-4.
    return 1.0 / (1.0 + exp(clamp(1.5957691 * x + 0.0713548 * x * x * x, vec3f(-80.0), vec3f(80.0))));
}

fn height(col: i32, row: i32) -> f32 {
    let border = frame.counts.w;
    let wide = frame.tile.z + 2 * border;
    let at = clamp(vec2i(col, row) + border, vec2i(0), vec2i(wide, frame.tile.w + 2 * border) - 1);
    return heights[at.y * wide + at.x];
}

// The height at a position in columns and rows of the tile, bilinear; MISSING if a corner is.
fn ground(at: vec2f) -> f32 {
    let first = vec2i(floor(at));
    let f = at - floor(at);
    let a = height(first.x, first.y);
    let b = height(first.x + 1, first.y);
    let c = height(first.x, first.y + 1);
    let d = height(first.x + 1, first.y + 1);
    if (min(min(a, b), min(c, d)) < 0.5 * MISSING) {
        return MISSING;
    }
    return mix(mix(a, b, f.x), mix(c, d, f.x), f.y);
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (i32(id.x) >= frame.tile.z || i32(id.y) >= frame.tile.w) {
        return;
    }
    let index = id.y * u32(frame.tile.z) + id.x;
    let col = frame.tile.x + i32(id.x);
    let row = frame.tile.y + i32(id.y);
    let z = height(i32(id.x), i32(id.y));
    if (z < 0.5 * MISSING) {
        return;
    }
    let g = gradient[index];
    let normal = normalize(vec3f(-g, 1.0));
    // A frame that tilts with the normal without turning about it: visibility varies smoothly between samples.
    let east = normalize(vec3f(1.0, 0.0, g.x));
    let north = cross(normal, east);
    let cell = frame.run.x;
    let radius = frame.run.y;
    let step = frame.counts.z == 1;
    let last = frame.counts.y - 1;
    let cellwise = vec2f(dot(g, frame.linear.xy), dot(g, frame.linear.zw)) / cell;
    var light = 0.0;
    for (var k = 0; k < frame.counts.x; k++) {
        let cone = cones[k];
        let way = cone.axis.x * east + cone.axis.y * north + cone.axis.z * normal;
        let run = vec3f(frame.inverse.xy * way.x + frame.inverse.zw * way.y, way.z);
        // How much of a horizontal direction is along columns and along rows.
        let weight = run.xy * run.xy / max(dot(run.xy, run.xy), 1e-12);
        let low = sin(cone.band.x);
        let high = sin(cone.band.y);
        let span = high * high - low * low;
        var t = frame.run.w * cell / (2.0 * cone.band.z);
        var dark = 0.0;
        var lost = 0.0;
        // Nearer than voxels can resolve, the ground itself hides a patch up to its own elevation.
        let across = cone.axis.x * east + cone.axis.y * north;
        let aside = normalize(across.xy + vec2f(1e-9, 0.0));
        let along = frame.inverse.xy * aside.x + frame.inverse.zw * aside.y;
        for (var s = NEAR * cell; s < min(t, radius); s *= FARTHER) {
            let h = ground(vec2f(id.xy) + s * along);
            let v = vec3f(s * aside, h - z);
            let far = length(v);
            if (h < 0.5 * MISSING || far > min(t, radius)) {
                continue;
            }
            let up = asin(clamp(dot(v, normal) / far, -1.0, 1.0));
            let edge = sin(clamp(up, cone.band.x, cone.band.y));
            let hidden = (edge * edge - low * low) / span;
            if (hidden > dark) {
                lost += (hidden - dark) * (rho_free() - select(rho(far, radius), 0.0, step));
                dark = hidden;
            }
        }
        var before = -1.0;
        while (t < radius) {
            let wide = max(2.0 * t * cone.band.z, cell);
            let lod = clamp(log2(wide * frame.run.z / cell), 0.0, f32(last));
            let fine = min(i32(lod), max(last - 1, 0));
            let p = vec3f(f32(col), f32(row), z) + t * run;
            var share = share_of(fine, p);
            if (last > 0) {
                share = mix(share, share_of(fine + 1, p), lod - f32(fine));
            }
            // The ground's own plane is no occluder, although a filter as wide as the cone reaches into it.
            let own = plane_share(t * (way.z - dot(g, way.xy)), cell * exp2(lod), cellwise);
            let hides = clamp((share - own) / max(1.0 - own, vec3f(1e-3)), vec3f(0.0), vec3f(1.0));
            let rising = select(clamp((hides.z - before - FLAT) / EDGE, 0.0, 1.0), 0.0, before < 0.0);
            before = hides.z;
            let filled = mix(hides.z, max(hides.z, dot(hides.xy, weight)), rising);
            // Ground fills a patch of the sky from below, where the cosine is smallest.
            let edge = sin(mix(cone.band.x, cone.band.y, filled));
            let hidden = (edge * edge - low * low) / span;
            if (hidden > dark) {
                // What is hidden now was free up to here.
                lost += (hidden - dark) * (rho_free() - select(rho(t, radius), 0.0, step));
                dark = hidden;
            }
            if (dark > 0.999) {
                break;
            }
            t += 0.5 * wide;
        }
        light += cone.axis.w * (rho_free() - lost);
    }
    result[index] = light;
}
