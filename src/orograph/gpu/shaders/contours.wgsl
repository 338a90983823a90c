// Contour lines: how much of a pixel they cover (rendering/lines/contour_kernels.py), and the smooth surface through the
// samples that near lines follow (rendering/lines/smooth.py).
// Needs ``heights`` (texture_2d_array), ``height_pages``, and what slopes.wgsl needs; ``shade`` (uniform): contour.
// include: place.wgsl

const HEIGHTS_SIDE: i32 = 257;
const MISSING: f32 = {{MISSING}}.0;   // added to missing heights

// A place moved by so many cells.
fn moved(at: Place, by: vec2<f32>) -> Place {
  let part = at.part + by;
  let down = floor(part);
  return Place(at.whole + vec2<i32>(down), part - down);
}

const SHORE = 0.3;   // samples inland from the shore within which heights follow it
const NO_SHORE = 9.0;

// How far a place f in a level cell lies from its shore, samples: from edges beyond which both samples differ, and
// corners beyond which one does, as slopes at the corners tell; NO_SHORE where there is none.
fn to_shore(s00: vec2<f32>, s10: vec2<f32>, s01: vec2<f32>, s11: vec2<f32>, f: vec2<f32>) -> f32 {
  let g = 1.0 - f;
  let none = vec4<f32>(NO_SHORE);
  let ends = vec4<f32>(s00.x, s10.x, s00.y, s01.y) * vec4<f32>(s01.x, s11.x, s10.y, s11.y);
  let edges = select(none, vec4<f32>(f.x, g.x, f.y, g.y), ends != vec4<f32>(0.0));
  let rises = vec4<f32>(dot(s00, s00), dot(s10, s10), dot(s01, s01), dot(s11, s11));
  let far = vec4<f32>(length(f), length(vec2<f32>(g.x, f.y)), length(vec2<f32>(f.x, g.y)), length(g));
  let nearest = min(edges, select(none, far, rises > vec4<f32>(0.0)));
  return min(min(nearest.x, nearest.y), min(nearest.z, nearest.w));
}

// How far a place f in a cell with corners h lies from the shore, samples, negative at sea; NO_SHORE where none is.
fn from_shore(h: vec4<f32>, f: vec2<f32>) -> f32 {
  let low = vec2<f32>(h.x + h.z, h.x + h.y);    // of the sides in the west and the north
  let high = vec2<f32>(h.y + h.w, h.z + h.w);   // in the east and the south
  if (min(min(h.x, h.y), min(h.z, h.w)) != 0.0 || low.x + high.x == 0.0) {
    return NO_SHORE;
  }
  let in_from = select(1.0 - f, f, high > vec2<f32>(0.0));
  let bare = min(low, high) == vec2<f32>(0.0);   // whether a side has no land
  if (all(bare)) {
    return sqrt(0.5) * (in_from.x + in_from.y - 1.0);
  }
  if (bare.x && min(h.x, h.z) + min(h.y, h.w) > 0.0) {
    return in_from.x;
  }
  return select(NO_SHORE, in_from.y, bare.y && min(h.x, h.y) + min(h.z, h.w) > 0.0);
}

// The smooth surface at a place: height, slope (in light's units, per sample along columns and rows), and 1 if all
// four samples are present, else 0.
fn smooth_surface(at: Place, footprint: f32) -> vec4<f32> {
  let l = levels[0];
  let cell = clamp(at.whole, vec2<i32>(0), camera.last - 1);
  let f = clamp(at.part + vec2<f32>(at.whole - cell), vec2<f32>(0.0), vec2<f32>(1.0));
  let tile = min(cell >> vec2<u32>(8u), vec2<i32>(i32(l.tile_cols), i32(l.tile_rows)) - 1);
  let page = l.offset + u32(tile.y) * l.tile_cols + u32(tile.x);
  let slot = i32(height_pages[page]) - 1;
  let other = i32(pages[page]) - 1;
  if (min(slot, other) < 0) {
    return vec4<f32>(0.0);
  }
  let local = cell - tile * 256;
  let place = slot % (PER_SIDE * PER_SIDE);
  let origin = vec2<i32>(place % PER_SIDE, place / PER_SIDE) * HEIGHTS_SIDE + local;
  let layer = slot / (PER_SIDE * PER_SIDE);
  // Four corners: x: (0, 0), y: (1, 0), z: (0, 1), w: (1, 1) of (column, row).
  let h = vec4<f32>(
    textureLoad(heights, origin, layer, 0).r, textureLoad(heights, origin + vec2<i32>(1, 0), layer, 0).r,
    textureLoad(heights, origin + vec2<i32>(0, 1), layer, 0).r, textureLoad(heights, origin + vec2<i32>(1, 1), layer, 0).r);
  if (any(h >= vec4<f32>(0.5 * MISSING))) {
    return vec4<f32>(0.0);
  }
  let s00 = load_slope(other, local + 1);
  let s10 = load_slope(other, local + vec2<i32>(2, 1));
  let s01 = load_slope(other, local + vec2<i32>(1, 2));
  let s11 = load_slope(other, local + 2);
  let g = 1.0 - f;
  let high = f * f * (3.0 - 2.0 * f);
  let low = 1.0 - high;
  let u = vec2<f32>(f.x * g.x * g.x, -f.x * f.x * g.x);
  let v = vec2<f32>(f.y * g.y * g.y, -f.y * f.y * g.y);
  var height = h.x + (h.y - h.x) * high.x * low.y + (h.z - h.x) * low.x * high.y + (h.w - h.x) * high.x * high.y;
  height += u.x * mix(s00.x, s01.x, f.y) + u.y * mix(s10.x, s11.x, f.y);
  height += v.x * mix(s00.y, s10.y, f.x) + v.y * mix(s01.y, s11.y, f.x);
  let west = s01.x - s00.x;
  let east = s11.x - s10.x;
  let north = s10.y - s00.y;
  let south = s11.y - s01.y;
  height -= u.x * v.x * (f.x * west + f.y * north) / max(f.x + f.y, 1e-9);
  height -= u.y * v.x * (g.x * east + f.y * north) / max(g.x + f.y, 1e-9);
  height -= u.x * v.y * (f.x * west + g.y * south) / max(f.x + g.y, 1e-9);
  height -= u.y * v.y * (g.x * east + g.y * south) / max(g.x + g.y, 1e-9);
  let slope = mix(mix(s00, s10, f.x), mix(s01, s11, f.x), f.y);
  let steep = length(slope);
  let clear = max(0.15, 6.0 * footprint);   // the surface goes down over level ground as far as hides the line
  let inland = from_shore(h, f);
  if (all(h == h.xxxx)) {
    height = h.x + select(-steep, steep, height > h.x) * min(to_shore(s00, s10, s01, s11, f), clear);
  } else if (inland != NO_SHORE) {
    height = mix(max(inland, -clear) * steep, height, smoothstep(0.0, SHORE, inland));
    height = select(height, max(height, 0.5 * inland * steep * (1.0 - inland)), inland > 0.0);
  }
  return vec4<f32>(height, slope, 1.0);
}

// The height that lines follow: that of the smooth surface where a pixel covers little of a sample, else the ground's.
// ``by_ray``: where the ray through the pixel meets that surface, else above or below the ground.
fn smooth_height(at: Place, footprint: f32, direction: vec3<f32>, ground: f32, by_ray: bool) -> f32 {
  var found = smooth_surface(at, footprint);
  let go = vec2<f32>(dot(camera.inverse.xy, direction.xy), dot(camera.inverse.zw, direction.xy));
  let drop = direction.z / camera.forward.w;
  var height = found.x;
  var gone = 0.0;
  for (var k = select(3, 0, by_ray && found.w > 0.0); k < 3; k++) {   // Newton's method
    let facing = drop - dot(found.yz, go);
    if (facing >= 0.0 || found.w == 0.0) {
      break;
    }
    gone += (found.x - ground - gone * drop) / facing;
    if (abs(gone) * length(go) >= 1.5) {
      break;
    }
    height = ground + gone * drop;
    found = smooth_surface(moved(at, gone * go), footprint);
  }
  return mix(height, ground, max(smoothstep(0.35, 0.7, footprint), select(1.0, 0.0, smooth_surface(at, footprint).w > 0.0)));
}

// The largest rate of height on the screen, metres per pixel: of ``slope`` on the tangent plane of slope ``drawn``.
fn line_rate(depth: f32, direction: vec3<f32>, drawn: vec2<f32>, slope: vec2<f32>) -> f32 {
  let normal = vec3<f32>(-drawn * camera.forward.w, 1.0);
  let facing = dot(normal, direction);
  let size = camera.pixel * select(depth, 1.0, camera.plan == 1u);   // metres of a pixel's step at this depth
  let u = camera.right.xyz * size;
  let v = camera.up.xyz * size;
  let over = u.xy - dot(normal, u) / facing * direction.xy;   // how far a pixel's step moves over the ground
  let down = v.xy - dot(normal, v) / facing * direction.xy;
  return max(length(vec2<f32>(dot(slope, over), dot(slope, down))), 1e-9);
}

// How much paper ground of this color needs to have a luminance (rendering/palette.py).
fn lifting(ground: vec3<f32>, least: f32) -> f32 {
  let weights = vec3<f32>(0.2126, 0.7152, 0.0722);
  let bright = dot(ground, weights);
  return max(least - bright, 0.0) / max(dot(shade.paper.rgb, weights) - bright, least);
}

// Parts of a pixel that contour lines and their casing cover: the height's derivative along the screen's axes on the tangent plane says how
// far the next contour is. ``drawn``: the slope of that plane; ``slope_here``: of heights. ``with_casing``: whether that is seen.
fn contours(
  height: f32, at: Place, footprint: f32, depth: f32, direction: vec3<f32>, drawn: vec2<f32>, slope_here: vec2<f32>, with_casing: bool,
) -> vec2<f32> {
  let rate = line_rate(depth, direction, drawn, slope_here);
  let n = height / shade.contour.x;
  let far = abs(n - round(n)) * shade.contour.x / rate;
  let index = shade.contour.y > 0.0 && abs(round(n) - shade.contour.y * round(n / max(shade.contour.y, 1.0))) < 0.25;
  let half = 0.5 * shade.contour.z * select(1.0, 2.0, index && round(n) != 0.0);   // a shore is a thin line
  // Where lines would be closer than a few pixels they fade: first the plain ones, then the index contours.
  let interval = shade.contour.x * select(1.0, shade.contour.y, index);
  // Ground too level has none: no line can be said to be its contour.
  let cased = select(0.0, half + shade.casing.z, with_casing);
  var cover = clamp(vec2<f32>(half, cased) - far + 0.5, vec2<f32>(0.0), vec2<f32>(1.0)) * smoothstep(3.0, 7.0, interval / rate);
  cover *= smoothstep(5e-5, 2e-4, length(slope_here));
  var total = 0.0;   // a line alone on a ledge among faded ones fades, too (thin_out)
  for (var k = select(4, 0, max(cover.x, cover.y) > 0.0); k < 4; k++) {
    let side = select(6.0, -6.0, k > 1) * footprint;
    let s = slope(moved(at, select(vec2<f32>(side, 0.0), vec2<f32>(0.0, side), (k & 1) == 1)), 4.0 * footprint);
    let g = vec2<f32>(dot(s, camera.inverse.xz), dot(s, camera.inverse.yw));
    total += min(line_rate(depth, direction, g, g), 1e6);
  }
  return cover * smoothstep(3.0, 7.0, 4.0 * interval / max(total, 1e-9));
}
