// Imagery laid over the ground: geovis/drape.py's lattice of image positions over the terrain, and the image with its
// pyramid of means. Needs ``drape``, ``drape_sampler``, ``lattice``.

// lattice[0]: columns and rows of the lattice's nodes, and of the image's texels; lattice[1], [2]: the affine map from
// metres east and north of the eye to nodes; then a node each: position in texels of the finest level (u, v), texels per
// metre, 1 if it is there.
fn drape_colour(position: vec3<f32>, metres: f32) -> vec4<f32> {
  let size = vec2<i32>(lattice[0].xy);
  let at = vec2<f32>(dot(lattice[1].xy, position.xy) + lattice[1].z, dot(lattice[2].xy, position.xy) + lattice[2].z);
  let k = clamp(vec2<i32>(floor(at)), vec2<i32>(0), size - 2);
  let f = at - vec2<f32>(k);
  let base = 3 + k.y * size.x + k.x;
  let node = mix(mix(lattice[base], lattice[base + 1], f.x), mix(lattice[base + size.x], lattice[base + size.x + 1], f.x), f.y);
  let extent = vec2<f32>(textureDimensions(drape, 0));
  let inside = all(node.xy >= vec2<f32>(-1e-3)) && all(node.xy <= lattice[0].zw + 1e-3) && node.w > 0.999;
  let level = log2(max(metres * lattice[base].z, 1.0));
  let colour = textureSampleLevel(drape, drape_sampler, node.xy / extent, level);
  return select(vec4<f32>(0.0), vec4<f32>(colour.rgb / max(colour.a, 1e-3), colour.a), inside);
}
