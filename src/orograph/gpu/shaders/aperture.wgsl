// Light through ambient apertures (Oat & Sander 2007): the twin of orograph.lighting.caps and orograph.lighting.aperture_kernels,
// with the same names. Include it and loop over lights:
//
//     let cap = cap_of(textureSampleLevel(caps, …));      // east, north, up, cosine of the radius
//     var sky = sky_through(cap, normal);
//     for each sun:  let seen = sun_through(cap, normal, sun, false); light += seen * sun.color; sky -= covered(seen, sun);
//     for each lamp: light += lamp_through(cap, normal, place, lamp) * lamp.color;
//     light += max(sky, 0.0) * ambient;
//
// Directions are unit vectors (east, north, up); places are metres from one origin near the eye; angles are radians.

// include: angles.wgsl

const POINT = 1e-5;  // radians below which a cap is seen whole or not at all

struct Cap {
    axis: vec3f,
    rim: f32,  // cosine of the radius
};

struct Sun {
    direction: vec3f,
    radius: f32,
    color: vec3f,  // irradiance of a surface perpendicular to it that sees all of it
    cosine: f32,    // of the radius
    sine: f32,
    area: f32,      // solid angle
    pad: vec2f,
};

struct Lamp {
    place: vec3f,
    pad: f32,
    color: vec3f,  // irradiance at one metre
    pad2: f32,
};

// Solid angle of a cap, accurate for small ones too.
fn cap_area(radius: f32) -> f32 {
    let half = sine_cosine(0.5 * radius).x;
    return 4.0 * PI * half * half;
}

// The part of a cap that the chord of a lens cuts off: a sector of half-angle `half` minus the triangle in it.
fn _segment(radius: f32, half: f32) -> f32 {
    let h = sine_cosine(0.5 * radius);
    let t = sine_cosine(2.0 * half);
    let square = h.x * h.x / (h.y * h.y);
    return 4.0 * half * h.x * h.x - 2.0 * angle_of(square * t.x, 1.0 + square * t.y);
}

// Solid angle that two caps of radii a, b ≤ π/2 share, their centres `distance` apart: the lens as its two segments, which
// is more accurate in float32 than the closed form of Tovchigrechko & Vakser 2001 (a difference of angles near π).
fn exact_overlap(distance: f32, a: f32, b: f32) -> f32 {
    let small = min(a, b);
    if (distance >= a + b) {
        return 0.0;
    }
    if (distance <= abs(a - b)) {
        return cap_area(small);
    }
    if (small < POINT) {
        return select(0.0, cap_area(small), distance <= max(a, b));
    }
    // The angles at the centres from their half angles, without inaccurate differences of cosines.
    let whole = sine_cosine(0.5 * (a + b + distance)).x;
    let less_a = sine_cosine(0.5 * (b + distance - a)).x;
    let less_b = sine_cosine(0.5 * (a + distance - b)).x;
    let less_d = sine_cosine(0.5 * (a + b - distance)).x;
    let at_a = 2.0 * angle_of(sqrt(max(less_a * less_d, 0.0)), sqrt(max(whole * less_b, 0.0)));
    let at_b = 2.0 * angle_of(sqrt(max(less_b * less_d, 0.0)), sqrt(max(whole * less_a, 0.0)));
    return clamp(_segment(a, at_a) + _segment(b, at_b), 0.0, cap_area(small));
}

// The share of the smaller of two caps that the larger covers, a smoothstep between all and nothing.
fn smooth_share(distance: f32, a: f32, b: f32) -> f32 {
    let least = abs(a - b);
    if (distance >= a + b || min(a, b) <= 0.0) {
        return 0.0;
    }
    if (distance <= least) {
        return 1.0;
    }
    // a + b − distance over a + b − |a − b|, which is twice the smaller.
    let x = (a + b - distance) / (2.0 * min(a, b));
    return x * x * (3.0 - 2.0 * x);
}

// `exact_overlap` with a smoothstep for the lens.
fn smooth_overlap(distance: f32, a: f32, b: f32) -> f32 {
    return cap_area(min(a, b)) * smooth_share(distance, a, b);
}

// A cap from an interpolated field; the open sky where there is none.
fn cap_of(field: vec4f) -> Cap {
    let size = length(field.xyz);
    if (!(size > 0.0)) {
        return Cap(vec3f(0.0, 0.0, 1.0), 0.0);
    }
    return Cap(field.xyz / size, field.w);
}

// Irradiance by the sky through a cap, as a fraction of what level open ground receives, before suns cover part of it.
fn sky_through(cap: Cap, normal: vec3f) -> f32 {
    return max(dot(normal, cap.axis), 0.0) * max(1.0 - cap.rim * cap.rim, 0.0);
}

// A sun: the area its disc shares with the cap, times the cosine of incidence in the middle of that area.
fn sun_through(cap: Cap, normal: vec3f, sun: Sun, exact: bool) -> f32 {
    let cosine = dot(cap.axis, sun.direction);
    let bend = sqrt(max(1.0 - cap.rim * cap.rim, 0.0)) * sun.sine;
    var facing = dot(normal, sun.direction);
    var part = 1.0;
    if (cosine < cap.rim * sun.cosine + bend || cap.rim > sun.cosine) {
        // A margin: near the end these float32 cosines cannot resolve 10⁻³ of a radius, but the overlap can.
        if (cosine <= cap.rim * sun.cosine - bend - 1e-6) {
            return 0.0;
        }
        let width = sun.radius;
        // Sine and cosine of the distance d from half the chord, accurate for small ones too; from these those of a − d,
        // how far the sun's centre lies inside the rim: where the rim cuts the disc, at most the disc's radius.
        let half = min(0.5 * length(cap.axis - sun.direction), 1.0);
        let across = 2.0 * half * sqrt(1.0 - half * half);
        let inside = small_of_sine(clamp(sqrt(max(1.0 - cap.rim * cap.rim, 0.0)) * cosine - cap.rim * across, -0.75, 0.75));
        let distance = 2.0 * small_of_sine(half);
        if (width <= 0.0) {
            part = 0.0;
        } else if (exact) {
            part = exact_overlap(angle_between(cap.axis, sun.direction), angle_of_cosine(cap.rim), width) / sun.area;
        } else {
            // The visible fraction of the smaller one is a smoothstep of a + b − d over twice the smaller radius.
            let x = clamp((inside + width) / (2.0 * min(width, max(acute_of_cosine(saturate(cap.rim)), 1e-6))), 0.0, 1.0);
            part = x * x * (3.0 - 2.0 * x) * min(2.0 * PI * (1.0 - cap.rim) / sun.area, 1.0);
        }
        // The middle of the lens lies on the arc from the sun's centre to the cap's, at this distance from the sun's.
        let back = clamp(0.5 * (width - inside), 0.0, distance);
        let turn = _sine(back) / max(across, 1e-6);
        facing = turn * dot(normal, cap.axis) + (_cosine(back) - turn * cosine) * facing;
    }
    return part * max(facing, 0.0);
}

// The part of the sky's light that a sun's disc replaces, given the result of sun_through.
fn covered(seen: f32, sun: Sun) -> f32 {
    return seen * sun.sine * sun.sine;
}

// A lamp is seen inside the cap and hidden outside; its light falls with the square of the distance.
fn lamp_through(cap: Cap, normal: vec3f, place: vec3f, lamp: Lamp) -> f32 {
    let way = lamp.place - place;
    let away = dot(way, way);
    if (away <= 0.0) {
        return 0.0;
    }
    let inverse = inverseSqrt(away);
    if (dot(cap.axis, way) * inverse < cap.rim) {
        return 0.0;
    }
    return max(dot(normal, way), 0.0) * inverse / away;
}
