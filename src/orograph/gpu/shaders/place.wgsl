// A place on the raster: whole sample and what is left of one, so that no digits are lost far from its corner.
struct Place { whole: vec2<i32>, part: vec2<f32> };   // (col, row)
