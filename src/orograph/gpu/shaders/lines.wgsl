// Silhouettes: how much of a pixel lines on breaks cover, and how far away they are (rendering/lines/silhouette_kernels.py).
// Needs ``breaks``, ``breaks_near`` (textures) and ``shade`` (uniform): casing; edge: their color and opacity; edge_range: nearest and farthest
// depth, width of the nearest lines in pixels, pixels to search around.

struct Line { cover: vec2<f32>, depth: f32 };   // by the line, and by its casing

fn silhouette(pixel: vec2<i32>) -> Line {
  var found = Line(vec2<f32>(0.0), 1.0);
  let casing = vec2<f32>(0.0, select(0.0, shade.casing.z, shade.casing.y > 0.0));
  let size = vec2<i32>(textureDimensions(breaks));
  let wide = i32(shade.edge_range.w);
  var most = 0.0;
  let first = max(pixel - wide, vec2<i32>(0)) >> vec2<u32>(3u);
  let last = min(pixel + wide, size - 1) >> vec2<u32>(3u);
  for (var r = first.y; r <= last.y; r++) {
    for (var c = first.x; c <= last.x; c++) {
      most = max(most, textureLoad(breaks_near, vec2<i32>(c, r), 0).r);
    }
  }
  let reach = select(-1, wide, most > 0.0);   // no iteration of the loop if nothing is near
  let span = log2(shade.edge_range.y / shade.edge_range.x);
  for (var r = -reach; r <= reach; r++) {
    for (var c = -reach; c <= reach; c++) {
      let at = pixel + vec2<i32>(c, r);
      if (any(at < vec2<i32>(0)) || any(at >= size)) {
        continue;
      }
      let here = textureLoad(breaks, at, 0);
      for (var k = 0; k < 2; k++) {
        let weight = select(here.g, here.r, k == 0);
        if (weight <= min(found.cover.x, found.cover.y)) {
          continue;
        }
        let z = select(here.a, here.b, k == 0);
        let d = select(
          vec2<f32>(max(abs(f32(c)) - 0.5, 0.0), f32(r) + 0.5), vec2<f32>(f32(c) + 0.5, max(abs(f32(r)) - 0.5, 0.0)), k == 0);
        let far = clamp((z - log2(shade.edge_range.x)) / span, 0.0, 1.0);
        let half = 0.5 * shade.edge_range.z * (1.0 - 0.4 * far) + casing;
        let cover = weight * clamp(half + 0.5 - length(d), vec2<f32>(0.0), min(2.0 * half, vec2<f32>(1.0)));
        found.depth = select(found.depth, exp2(z), cover.y > found.cover.y);
        found.cover = max(found.cover, cover);
      }
    }
  }
  return found;
}

// A color with the silhouettes of a pixel over it; ``d``: the ray's unit direction, for the haze before them; ``cased``: 1 with
// their casing, else 0.
fn outlined(color: vec3<f32>, pixel: vec2<i32>, d: vec3<f32>, cased: f32) -> vec3<f32> {
  let line = silhouette(pixel);
  if (line.cover.y <= 0.0) {
    return color;
  }
  var ink = shade.edge.rgb;
  var light = shade.paper.rgb;
  if ((FLAGS & 256u) != 0u) {
    ink = haze(ink, d, line.depth);
    light = haze(light, d, line.depth);
  }
  return mix(mix(color, light, line.cover.y * cased * shade.casing.y), ink, line.cover.x * shade.edge.w);
}
