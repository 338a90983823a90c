// A place on the raster: whole sample and remainder, so that no precision is lost far from its corner.
struct Place { whole: vec2<i32>, part: vec2<f32> };   // (col, row)
