// Light on a place from maps: the sun over the skyline, shares of the sky, caps of open sky.

fn map_value(offset: i32, size: vec2<i32>, first: vec2<i32>, level: i32, at: Place) -> f32 {
  let p = in_blocks(at, u32(level));
  let q = p.whole - first;
  let most = max(size - 2, vec2<i32>(0));
  let clamped = clamp(q, vec2<i32>(0), most);
  let f = clamp(p.part + vec2<f32>(q - clamped), vec2<f32>(0.0), vec2<f32>(1.0));
  let next = min(clamped + 1, size - 1);
  let top = mix(maps[offset + clamped.y * size.x + clamped.x], maps[offset + clamped.y * size.x + next.x], f.x);
  let low = mix(maps[offset + next.y * size.x + clamped.x], maps[offset + next.y * size.x + next.x], f.x);
  return mix(top, low, f.y);
}

// The part of the sun's disc above the horizon, given the horizon's height over the disc's centre in radii.
fn disc_part(d: f32) -> f32 {
  let c = clamp(d, -1.0, 1.0);
  return (acos(c) - c * sqrt(1.0 - c * c)) / PI;
}

// The visible part of the sun: by rays, or by the finest window of horizons that contains the place.
fn sunlit(at: Place, footprint: f32) -> f32 {
  // when: RAYS
  if ((FLAGS & 262144u) != 0u) {
    return sun_above_skyline(at, footprint);
  }
  // end: RAYS
  for (var w = i32(shade.windows) - 1; w >= 0; w--) {
    let window = windows[w];
    let p = in_blocks(at, u32(window.level));
    let q = p.whole - vec2<i32>(window.col0, window.row0);
    if (w == 0 || (all(q >= vec2<i32>(1)) && all(q < vec2<i32>(window.cols, window.rows) - 2))) {
      return disc_part(map_value(window.offset, vec2<i32>(window.cols, window.rows), vec2<i32>(window.col0, window.row0), window.level, at));
    }
  }
  return 1.0;
}

// The window of the field to look up, like lighting/field.py: of those with the place, the one nearest in size to a pixel.
fn field_window(at: Place, footprint: f32) -> u32 {
  let wanted = i32(floor(log2(max(footprint, 1.0)) + 0.5));
  for (var w = i32(shade.fields) - 1; w > 0; w--) {
    let window = windows[shade.windows + u32(w)];
    let q = in_blocks(at, u32(window.level)).whole - vec2<i32>(window.col0, window.row0);
    if (window.level >= wanted && all(q >= vec2<i32>(1)) && all(q < vec2<i32>(window.cols, window.rows) - 2)) {
      return u32(w);
    }
  }
  return 0u;
}

// Two numbers in a word (lighting/gpu/aperture.py, packed): one of −1 … 1, one of 0 … 1.
fn packed_pair(word: f32) -> vec2<f32> {
  let bits = bitcast<i32>(word);
  return vec2<f32>(f32((bits << 16u) >> 16u) * (1.0 / 32767.0), f32((bits >> 16u) - 128) * (1.0 / 32384.0));
}

// The field at a sample: one number, or the four of a cap.
fn field_at(window: Window, at: vec2<i32>) -> vec4<f32> {
  if ((FLAGS & 128u) == 0u) {
    return vec4<f32>(maps[window.offset + at.y * window.cols + at.x], 0.0, 0.0, 0.0);
  }
  let k = window.offset + (at.y * window.cols + at.x) * 2;
  return vec4<f32>(packed_pair(maps[k]), packed_pair(maps[k + 1])).xzyw;
}

fn field_value(at: Place, footprint: f32) -> vec4<f32> {
  if (shade.fields == 0u) {   // not ready yet: the open sky
    return select(vec4<f32>(1.0), vec4<f32>(0.0, 0.0, 1.0, 0.0), (FLAGS & 128u) != 0u);
  }
  let window = windows[shade.windows + field_window(at, footprint)];
  let p = in_blocks(at, u32(window.level));
  let size = vec2<i32>(window.cols, window.rows);
  let q = p.whole - vec2<i32>(window.col0, window.row0);
  let first = clamp(q, vec2<i32>(0), max(size - 2, vec2<i32>(0)));
  let f = clamp(p.part + vec2<f32>(q - first), vec2<f32>(0.0), vec2<f32>(1.0));
  let next = min(first + 1, size - 1);
  let top = mix(field_at(window, first), field_at(window, vec2<i32>(next.x, first.y)), f.x);
  let low = mix(field_at(window, vec2<i32>(first.x, next.y)), field_at(window, next), f.x);
  return mix(top, low, f.y);
}

// Light through the cap over a place: discs, points, the sky between them, and ground where sky is hidden.
fn through_apertures(cap: Cap, normal: vec3<f32>, place: vec3<f32>) -> vec3<f32> {
  var sky = sky_through(cap, normal);
  var light = vec3<f32>(0.0);
  for (var k = 0u; k < select(SUNS, shade.suns, SUNS == 7u); k++) {
    if ((FLAGS & 1u) != 0u) {
      let seen = sun_through(cap, normal, suns[k], false);
      light += seen * suns[k].color;
      sky -= covered(seen, suns[k]);
    } else {   // nothing casts shadows
      light += max(dot(normal, suns[k].direction), 0.0) * suns[k].color;
    }
  }
  for (var k = 0u; k < select(0u, shade.lamps, (FLAGS & 131072u) != 0u); k++) {
    light += lamp_through(cap, normal, place, lamps[k]) * lamps[k].color;
  }
  let around = shade.skylight.w * (shade.sunlight.rgb + shade.skylight.rgb);
  return light + max(sky, 0.0) * shade.skylight.rgb + cap.rim * cap.rim * around;
}
