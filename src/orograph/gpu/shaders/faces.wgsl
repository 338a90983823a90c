// A single triangle, whose vertices each know all three: its slope and its edges.
// Needs camera.wgsl, drawn.wgsl and field.wgsl.

const EDGES: u32 = {{EDGES}}u;   // 1: mark how much of a pixel the edges of triangles cover

struct Vertex {
  @builtin(position) position: vec4<f32>,
  @location(0) part: vec3<f32>,                     // barycentric: 1 at its own corner
  @location(1) @interpolate(flat) what: u32,
  @location(2) @interpolate(flat) slope: vec2<f32>,  // of the true triangle, metres per metre east and north
  @location(3) cell: vec2<f32>,                      // (col, row) from the eye's
};

struct Point { whole: vec2<i32>, part: vec2<f32>, height: f32 };   // (col, row): whole samples, and the remainder; metres

// (col, row) of a point relative to a cell: whole cells are subtracted in integers.
fn from_cell(p: Point, cell: vec2<i32>) -> vec2<f32> {
  return vec2<f32>(p.whole - cell) + p.part;
}

// Corner k of a triangle.
fn face(k: u32, a: Point, b: Point, c: Point) -> Vertex {
  var own = a;
  if (k == 1u) {
    own = b;
  } else if (k == 2u) {
    own = c;
  }
  let cell = from_cell(own, camera.eye_cell);
  let here = vec3<f32>(from_eye(cell), own.height);
  let u = from_cell(b, a.whole) - from_cell(a, a.whole);
  let v = from_cell(c, a.whole) - from_cell(a, a.whole);
  let area = u.x * v.y - u.y * v.x;   // in samples, twice: 4^s if the legs follow rows and columns, else 2 · 4^s
  let rise = vec2<f32>(b.height - a.height, c.height - a.height);
  let across = vec2<f32>(rise.x * v.y - rise.y * u.y, rise.y * u.x - rise.x * v.x)
    / select(area, 1.0, area == 0.0);   // (an upright triangle has no slope)
  let size = u32(clamp(round(log2(max(abs(area), 1.0))), 0.0, 60.0));
  var out: Vertex;
  out.position = to_clip(vec3<f32>(here.xy, above_eye(here.z)));
  out.part = select(vec3<f32>(0.0), vec3<f32>(1.0), vec3<u32>(0u, 1u, 2u) == vec3<u32>(k));
  out.what = ((size >> 1u) << 8u) | ((size & 1u) << 4u) | 1u;
  out.cell = cell;
  out.slope = vec2<f32>(dot(across, camera.inverse.xz), dot(across, camera.inverse.yw));
  return out;
}

// How much of a pixel the triangle's edges cover (0–255), a pixel wide with those of its neighbours.
fn edges(part: vec3<f32>) -> u32 {
  let width = max(fwidth(part), vec3<f32>(1e-6));
  let away = part / width;
  let room = 1.0 / max(max(width.x, width.y), width.z);   // pixels from a corner to the opposite side
  return u32(255.0 * edge_strength(room) * clamp(1.0 - min(min(away.x, away.y), away.z), 0.0, 1.0));
}

fn marked(in: Vertex) -> u32 {
  // See patches.wgsl: seen edge on, a triangle's depth is extrapolated beyond its corners by some rasterisers.
  if (camera.plan == 0u && fwidth(in.position.z) > 4.0 * in.position.z) {
    discard;
  }
  if (EDGES == 0u) {
    return in.what;
  }
  return in.what | (edges(in.part) << 16u);
}

@fragment
fn fragment(in: Vertex) -> @location(0) u32 {
  return marked(in);
}

@fragment
fn with_slope(in: Vertex) -> WithSlope {
  return WithSlope(marked(in), in.slope);
}

// The same, and the terrain's own height, which contour lines follow: the triangle's is as coarse as the triangle.
@fragment
fn with_field(in: Vertex) -> WithField {
  let marks = marked(in);
  let down = floor(in.cell);
  let whole = camera.eye_cell + vec2<i32>(down);
  let inside = clamp(whole, vec2<i32>(0), camera.last);
  let part = select(vec2<f32>(0.0), in.cell - down, (inside == whole) & (inside < camera.last));
  return WithField(marks, in.slope, field_height(Place(inside, part)));
}
