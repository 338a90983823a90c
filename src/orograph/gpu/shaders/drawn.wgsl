// What geometry leaves in a pixel besides its depth: a word of marks, and on request the slope of the drawn surface
// there (metres per metre east and north) and the terrain's own height.

struct WithSlope { @location(0) marks: u32, @location(1) slope: vec2<f32> };

struct WithField { @location(0) marks: u32, @location(1) slope: vec2<f32>, @location(2) field: f32 };

// Strength of the edges of triangles so many pixels high: those of low ones would merge into a dark area (rendering/cpu/wireframe.py).
fn edge_strength(room: f32) -> f32 {
  return clamp(room / 5.0, 0.3, 1.0);
}
