// The camera and the grid, differenced on the CPU in double precision: no shader ever receives a large coordinate.
// Sample (col, row) lies (linear · ((col, row) − eye_cell − eye_frac)) metres east and north of the eye.

struct Camera {
  right: vec4<f32>,          // xyz: unit axes of the camera in stretched space; w of right: focal x, of up: focal y (clip units
  up: vec4<f32>,             //   per metre at unit depth, or per metre in a plan)
  forward: vec4<f32>,        // w: exaggeration
  linear: vec4<f32>,         // metres east per column, per row; metres north per column, per row
  inverse: vec4<f32>,        // columns per metre east, north; rows per metre east, north
  eye_frac: vec2<f32>,       // fractional part of the eye's sample coordinates
  centre: vec2<f32>,         // clip offset of the optical axis
  eye_cell: vec2<i32>,       // whole part (col, row)
  last: vec2<i32>,           // the raster's last column and row
  eye_height: vec2<f32>,     // metres, high and low part
  near: f32,                 // metres
  far: f32,                  // metres: in a plan only
  size: vec2<f32>,           // pixels
  plan: u32,                 // 1: parallel rays
  pixel: f32,                // metres: the size of a pixel at unit depth, or anywhere in a plan
  shift: vec2<f32>,          // the position in its pixel of the sample, pixels from the centre
};

@group(0) @binding(0) var<uniform> camera: Camera;

// Metres east and north of the eye; cells are counted from the eye's, so that near ground keeps full precision.
fn from_eye(cell: vec2<f32>) -> vec2<f32> {
  let d = cell - camera.eye_frac;
  return vec2<f32>(dot(camera.linear.xy, d), dot(camera.linear.zw, d));
}

// Stretched metres above the eye.
fn above_eye(height: f32) -> f32 {
  return ((height - camera.eye_height.x) - camera.eye_height.y) * camera.forward.w;
}

// Clip position of a point relative to the eye (stretched); depth is reversed: 1 near, 0 far.
fn to_clip(p: vec3<f32>) -> vec4<f32> {
  let x = dot(camera.right.xyz, p) * camera.right.w;
  let y = dot(camera.up.xyz, p) * camera.up.w;
  let z = dot(camera.forward.xyz, p);
  if (camera.plan == 1u) {
    return vec4<f32>(x + camera.centre.x, y + camera.centre.y, (camera.far - z) / (camera.far - camera.near), 1.0);
  }
  return vec4<f32>(x + camera.centre.x * z, y + camera.centre.y * z, camera.near, z);
}

// View-space depth (metres along the axis) of a value of the depth buffer.
fn depth_of(stored: f32) -> f32 {
  if (camera.plan == 1u) {
    return camera.far - stored * (camera.far - camera.near);
  }
  return camera.near / stored;
}

// The ray through a pixel position: its origin relative to the eye (stretched), and its direction with unit
// forward component.
struct Ray {
  origin: vec3<f32>,
  direction: vec3<f32>,
};

fn ray_of(pixel: vec2<f32>) -> Ray {
  let clip = vec2<f32>(2.0 * pixel.x / camera.size.x - 1.0, 1.0 - 2.0 * pixel.y / camera.size.y) - camera.centre;
  let across = camera.right.xyz * (clip.x / camera.right.w) + camera.up.xyz * (clip.y / camera.up.w);
  if (camera.plan == 1u) {
    return Ray(across, camera.forward.xyz);
  }
  return Ray(vec3<f32>(0.0), across + camera.forward.xyz);
}
