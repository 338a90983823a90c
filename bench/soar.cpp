// SOAR in plain C++, to measure orograph.lod.soar against (bench/soar.py compiles and calls it).
//
// The same loop with the same decisions: the anisotropic bound in double precision over spheres of float, culling that
// inherits "inside", both children weighed when their parent is split, and one generalised strip of (key, height) out.
// It recurses, as the papers do. Three memories are behind it: `Rows`, one dense row-major array of structs, as SOAR's
// own code would have without its hierarchical order; `Pages`, the pages of orograph.lod.pages; `Called`, these with
// the same prefetches.

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace {

struct Entry {
    float height, error, radius, color;
};

struct Vertex {
    int32_t row, col;
    float height;
};

struct Rows {
    static constexpr bool prefetches = false;
    const Entry *entries;
    int64_t side;
    const Entry *at(int32_t row, int32_t col, int) const { return entries + row * side + col; }
};

struct Pages {
    static constexpr bool prefetches = false;
    const Entry *entries;
    const int32_t *table;
    const int64_t *base, *width, *down, *across;
    int top;
    const Entry *at(int32_t row, int32_t col, int octave) const {
        const int level = std::min(octave, top);
        const int64_t i = row >> level, j = col >> level;
        const int64_t slot = table[base[level] + (i >> 8) * width[level] + (j >> 8)];
        return entries + (slot << 16) + ((down[i & 255] + across[j & 255]) >> 2);
    }
};

struct Called : Pages {
    static constexpr bool prefetches = true;
};

enum State { DROP, LEAF, SPLIT };

struct Diamond {
    State state;
    float height;
    int mask;
};

template <class Memory> class Refinement {
  public:
    Refinement(const Memory &memory, const double *lens, int n, int64_t *keys, float *heights)
        : memory(memory), lens(lens), n(n), keys(keys), heights(heights) {}

    int64_t length = 0, triangles = 0, nodes = 0;

    void run(const float *corners) {
        const int32_t side = 1 << n;
        const Vertex nw{0, 0, corners[0]}, ne{0, side, corners[1]}, sw{side, 0, corners[2]}, se{side, side, corners[3]};
        root(nw, se, ne);
        root(se, nw, sw);
    }

  private:
    const Memory memory;
    const double *lens;
    const int n;
    int64_t *keys;
    float *heights;
    bool open = false, newest_is_e = false;

    static Vertex middle(const Vertex &p, const Vertex &q) { return {(p.row + q.row) >> 1, (p.col + q.col) >> 1, 0.0f}; }

    Diamond weigh(const Vertex &m, int level, int mask) {
        ++nodes;
        const Entry entry = *memory.at(m.row, m.col, n - 1 - (level >> 1));
        const double col = m.col, row = m.row, z = entry.height, e = entry.error, r = entry.radius * lens[15];
        if (r < 0.0) return {DROP, z_of(entry), mask};
        if (mask != 63)
            for (int plane = 0; plane < 6; ++plane) {
                if (mask >> plane & 1) continue;
                const double *p = lens + 20 + 4 * plane;
                const double d = p[0] * col + p[1] * row + p[2] * z + p[3];
                if (d < -r) return {DROP, z_of(entry), mask};
                if (d >= r) mask |= 1 << plane;
            }
        const double w = lens[8] * col + lens[9] * row + lens[10] * z + lens[11];
        const double p = lens[46] * col + lens[47] * row + lens[48];
        const double q = lens[49] * col + lens[50] * row + lens[51];
        const double square = p * p + q * q;
        const double away = std::fabs(square + w * (w * lens[16] * lens[16] - 2.0 * (lens[2] * p + lens[6] * q)));
        const double depth = w - r;
        const double moved = std::max(depth, lens[14]) - e * std::fabs(lens[10]);
        const double pixels = lens[12] * e, goal = lens[13] * moved;
        const double reach = pixels * depth, spread = pixels * r, a = w * depth * goal;
        const double aa = a * a, bq = spread * spread * away, rest = aa + bq - reach * reach * square;
        const bool far = (depth <= 0.0) | (aa < bq) | (rest < 0.0) | (4.0 * aa * bq > rest * rest);
        const bool exceeds = (pixels > 0.0) & ((far & (pixels * lens[52] > goal)) | !(moved > 0.0));
        return {exceeds ? SPLIT : LEAF, z_of(entry), mask};
    }

    static float z_of(const Entry &entry) { return entry.color < 0.0f ? NAN : entry.height; }

    void call(const Vertex &p, const Vertex &q, int octave) {
        const Vertex m = middle(p, q);
        __builtin_prefetch(memory.at(m.row, m.col, octave));
        __builtin_prefetch(memory.at(m.row + (1 << octave), m.col, octave));
        __builtin_prefetch(memory.at(m.row, m.col + (1 << octave), octave));
    }

    void append(const Vertex &v) {
        keys[length] = (int64_t)v.row << 32 | v.col;
        heights[length++] = v.height;
    }

    void begin(bool even, const Vertex &a, const Vertex &b) {
        if (length) {
            keys[length] = keys[length - 1];
            heights[length] = heights[length - 1];
            ++length;
            append(a);
        }
        if ((length & 1) == even) append(a);
        append(a);
        append(b);
    }

    static bool draws(const Vertex &e, const Vertex &x, const Vertex &a) {
        const float total = e.height + x.height + a.height;
        return total == total;
    }

    // (e, x, a): a first child that is drawn, left over its leg at x.
    void first_leaf(const Vertex &e, const Vertex &x, const Vertex &a, int level, int second) {
        if (!draws(e, x, a)) {
            open = false;
            return;
        }
        const bool by_leg = ((level - second) & 1) == 0;
        const Vertex &keep = by_leg ? a : x, &fresh = by_leg ? x : a;
        if (!open) {
            begin(((level & 1) == 1) == by_leg, e, keep);
            open = true;
            newest_is_e = false;
        }
        if (newest_is_e) append(keep);
        append(fresh);
        newest_is_e = by_leg;
        ++triangles;
    }

    // A second child that is drawn, entered over its leg at e.
    void second_leaf(const Vertex &e, const Vertex &x, const Vertex &a, int level, int ahead) {
        if (!draws(e, x, a)) {
            open = false;
            return;
        }
        const bool by_leg = ((level - ahead) & 1) == 0;
        if (!open) {
            if (by_leg)
                begin((level & 1) == 1, e, a);
            else
                begin((level & 1) == 0, a, e);
            open = true;
            newest_is_e = !by_leg;
        }
        if (newest_is_e == by_leg) append(by_leg ? a : e);
        append(x);
        newest_is_e = true;
        ++triangles;
    }

    // (e, x, a) of the level above is split at m.
    void refine(const Vertex &e, const Vertex &x, const Vertex &a, const Vertex &m, int level, int mask, int second,
                int ahead) {
        if (level == 2 * n) {
            first_leaf(e, a, m, level, second);
            second_leaf(a, x, m, level, ahead);
            return;
        }
        Vertex m1 = middle(e, a), m2 = middle(a, x);
        const Diamond one = weigh(m1, level, mask), two = weigh(m2, level, mask);
        m1.height = one.height;
        m2.height = two.height;
        if (Memory::prefetches && (level & 1) == 0 && level + 2 < 2 * n) {
            const int octave = n - 2 - (level >> 1);
            if (one.state == SPLIT) call(e, m1, octave), call(a, m1, octave), call(m, m1, octave);
            if (two.state == SPLIT) call(a, m2, octave), call(m, m2, octave), call(x, m2, octave);
        }
        if (one.state == SPLIT)
            refine(e, a, m, m1, level + 1, one.mask, second, level);
        else if (one.state == LEAF)
            first_leaf(e, a, m, level, second);
        else
            open = false;
        if (two.state == SPLIT)
            refine(a, x, m, m2, level + 1, two.mask, level, ahead);
        else if (two.state == LEAF)
            second_leaf(a, x, m, level, ahead);
        else
            open = false;
    }

    void root(const Vertex &e, const Vertex &x, const Vertex &a) {
        Vertex m = middle(e, x);
        const Diamond whole = weigh(m, 0, 0);
        m.height = whole.height;
        open = false;
        if (whole.state == SPLIT)
            refine(e, x, a, m, 1, whole.mask, 0, 0);
        else if (whole.state == LEAF)
            second_leaf(e, x, a, 0, 0);
    }
};

template <class Memory>
void refine(const Memory &memory, const double *lens, int n, const float *corners, int64_t *keys, float *heights,
            int64_t *counts) {
    Refinement<Memory> refinement(memory, lens, n, keys, heights);
    refinement.run(corners);
    counts[0] = refinement.length;
    counts[1] = refinement.triangles;
    counts[2] = refinement.nodes;
}

} // namespace

extern "C" void soar_rows(const void *entries, const double *lens, int n, const float *corners, int64_t *keys,
                          float *heights, int64_t *counts) {
    refine(Rows{(const Entry *)entries, (1 << n) + 1}, lens, n, corners, keys, heights, counts);
}

extern "C" void soar_pages(const void *entries, const int32_t *table, const int64_t *base, const int64_t *width,
                           const int64_t *down, const int64_t *across, int top, int prefetches, const double *lens, int n,
                           const float *corners, int64_t *keys, float *heights, int64_t *counts) {
    const Pages pages{(const Entry *)entries, table, base, width, down, across, top};
    if (prefetches)
        refine(Called{pages}, lens, n, corners, keys, heights, counts);
    else
        refine(pages, lens, n, corners, keys, heights, counts);
}
