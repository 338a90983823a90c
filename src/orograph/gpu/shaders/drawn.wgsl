// What geometry leaves in a pixel besides its depth: a word of marks, and where it is asked for the slope of what is drawn
// there (metres per metre east and north) and the terrain's own height.

struct WithSlope { @location(0) marks: u32, @location(1) slope: vec2<f32> };

struct WithField { @location(0) marks: u32, @location(1) slope: vec2<f32>, @location(2) field: f32 };

// How strong edges of triangles so many pixels high are: of low ones they would make one dark area (rendering/cpu/wireframe.py).
fn edge_strength(room: f32) -> f32 {
  return clamp(room / 5.0, 0.3, 1.0);
}
