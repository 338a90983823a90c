// Angles to float32 accuracy on every GPU. WGSL guarantees only 2⁻¹¹ for sin and cos and 4096 ULP for atan and acos,
// and drivers use that freedom; here errors stay under 3e-7 (Cephes' sinf, cosf and atanf, Moshier 1989).

const PI = 3.14159265358979;

fn _sine(x: f32) -> f32 {  // |x| ≤ π/4
    let z = x * x;
    return ((-1.9515295891e-4 * z + 8.3321608736e-3) * z - 1.6666654611e-1) * z * x + x;
}

fn _cosine(x: f32) -> f32 {
    let z = x * x;
    return ((2.443315711809948e-5 * z - 1.388731625493765e-3) * z + 4.166664568298827e-2) * z * z - 0.5 * z + 1.0;
}

// Sine and cosine of an angle of up to a few turns, radians.
fn sine_cosine(angle: f32) -> vec2f {
    let quarter = round(angle * (2.0 / PI));
    // π/2 in two parts; products of the first with quarters are exact.
    let x = (angle - quarter * 1.5703125) - quarter * 4.83826794896619e-4;
    let s = _sine(x);
    let c = _cosine(x);
    let turn = i32(quarter) & 3;
    let swapped = select(vec2f(s, c), vec2f(c, s), (turn & 1) == 1);
    return vec2f(select(swapped.x, -swapped.x, turn >= 2), select(swapped.y, -swapped.y, turn == 1 || turn == 2));
}

// The angle of the direction (x, y), −π … π; 0 for (0, 0).
fn angle_of(y: f32, x: f32) -> f32 {
    let a = abs(x);
    let b = abs(y);
    let most = max(a, b);
    if (most == 0.0) {
        return 0.0;
    }
    let ratio = min(a, b) / most;
    // Beyond tan(π/8), use the angle minus π/4.
    let far = ratio > 0.4142135623730950;
    let t = select(ratio, (ratio - 1.0) / (ratio + 1.0), far);
    let z = t * t;
    var angle = ((((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1) * z * t + t)
        + select(0.0, 0.25 * PI, far);
    if (b > a) {
        angle = 0.5 * PI - angle;
    }
    if (x < 0.0) {
        angle = PI - angle;
    }
    return select(angle, -angle, y < 0.0);
}

// The angle whose cosine is c, as accurate as c allows: near 1 that is not much (use angle_between there).
fn angle_of_cosine(c: f32) -> f32 {
    return angle_of(sqrt(max((1.0 - c) * (1.0 + c), 0.0)), c);
}

// The same for 0 ≤ c ≤ 1 in a third of the time, within 1e-7 (Abramowitz & Stegun 1964, 4.4.46).
fn acute_of_cosine(c: f32) -> f32 {
    let p = ((((((-0.0012624911 * c + 0.0066700901) * c - 0.0170881256) * c + 0.0308918810) * c - 0.0501743046) * c
        + 0.0889789874) * c - 0.2145988016) * c + 1.5707963050;
    return sqrt(1.0 - c) * p;
}

// The angle whose sine is x, |x| ≤ ½ (Cephes' asinf); within 1e-4 up to 45°.
fn small_of_sine(x: f32) -> f32 {
    let z = x * x;
    return ((((4.2163199048e-2 * z + 2.4181311049e-2) * z + 4.5470025998e-2) * z + 7.4953002686e-2) * z
        + 1.6666752422e-1) * z * x + x;
}

// The angle between unit vectors, accurate even where it is small.
fn angle_between(a: vec3f, b: vec3f) -> f32 {
    return angle_of(length(cross(a, b)), dot(a, b));
}
