// What an occluder at a distance lets through (orograph.lighting.rho): a table of ρ over [0, R), and ρ(R) separately.
// In `table`, the last value is ρ(R) for a ray that hits nothing; the others cover equal parts of [0, R].

fn rho(length: f32, radius: f32) -> f32 {
    let last = arrayLength(&table) - 2u;
    let x = clamp(length / radius, 0.0, 1.0) * f32(last);
    let k = min(u32(x), last - 1u);
    return mix(table[k], table[k + 1u], x - f32(k));
}

fn rho_free() -> f32 {
    return table[arrayLength(&table) - 1u];
}
