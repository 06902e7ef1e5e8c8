#include "remesh.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "linked_surface.h"

namespace deltamic_remesh {
namespace {

constexpr double too_long = 4.0 / 3, too_short = 4.0 / 5;  // of the wanted length
constexpr double turned = 0.5;       // cosine up to which an operation may turn a face
constexpr double flat = 0.8;         // cosine between two faces whose diagonal may be flipped
constexpr double good_enough = 0.3;  // quality (1: equilateral) that no operation may go below
constexpr double pace = 0.5;         // share of the way that a vertex moves to its place in a pass

class Remesher : LinkedSurface {
public:
    explicit Remesher(Surface& s) : LinkedSurface(s) {}

    Counts run(int passes, bool smooth, double apart) {
        if (apart > 0) sort_in(apart);
        for (int pass = 0; pass < passes; ++pass) {
            split_all();
            collapse_all();
            flip_all();
            if (smooth) {
                move_all();
                flip_all();
            }
        }
        pack();
        return counts_;
    }

private:
    Counts counts_;

    // ------------------------------------------------------------------------------- split

    void split_all() {
        std::vector<Edge> found = edges([&](const Edge& e) { return e.length > too_long * wanted_length(e.a, e.b); });
        std::sort(found.begin(), found.end(), [](const Edge& p, const Edge& q) { return p.length > q.length; });
        for (const Edge& e : found)
            if (!is_sealed(e.a, e.b)) split(e.a, e.b);
    }

    void split(std::int32_t a, std::int32_t b) {
        find_shared(a, b);
        const bool junction = is_junction();
        const auto m = static_cast<std::int32_t>(s_.position.size());
        s_.position.push_back(0.5 * (at(a) + at(b)));
        s_.length.push_back(wanted_length(a, b));
        s_.fixed.push_back(s_.fixed[a] && s_.fixed[b] ? held : loose);
        s_.origin.push_back(-1);
        s_.guard.push_back(std::max(s_.guard[a], s_.guard[b]));
        for (std::size_t k = 0; k < s_.columns; ++k)
            s_.carried.push_back((s_.carried[a * s_.columns + k] + s_.carried[b * s_.columns + k]) / 2);
        alive_.push_back(1);
        stamp_.push_back(0);
        kind_.push_back(s_.fixed[m] ? corner : junction ? line : inner);
        faces_of_.emplace_back();
        for (std::int32_t f : std::vector<std::int32_t>(shared_)) {
            const auto g = static_cast<std::int32_t>(s_.face.size());
            const std::int32_t c = opposite(f, a, b);
            s_.face.push_back(s_.face[f]);
            s_.region.push_back(s_.region[f]);
            std::replace(s_.face[f].begin(), s_.face[f].end(), b, m);
            std::replace(s_.face[g].begin(), s_.face[g].end(), a, m);
            faces_of_[m].push_back(f);
            faces_of_[m].push_back(g);
            std::replace(faces_of_[b].begin(), faces_of_[b].end(), f, g);
            faces_of_[c].push_back(g);
            renew(f);
            renew(g);
        }
        ++counts_.splits;
    }

    // ---------------------------------------------------------------------------- collapse

    void collapse_all() {
        std::vector<Edge> found = edges([&](const Edge& e) { return e.length < too_short * wanted_length(e.a, e.b); });
        std::sort(found.begin(), found.end(), [](const Edge& p, const Edge& q) { return p.length < q.length; });
        for (const Edge& e : found) {
            if (!alive_[e.a] || !alive_[e.b]) continue;
            find_shared(e.a, e.b);
            if (shared_.empty() || norm(at(e.b) - at(e.a)) >= too_short * wanted_length(e.a, e.b)) continue;
            collapse(e.a, e.b);
        }
    }

    // b is merged into a, if that leaves every region as it is.
    void collapse(std::int32_t a, std::int32_t b) {
        if (kind_[a] < kind_[b]) std::swap(a, b);
        if (kind_[b] == corner || (kind_[b] == line && !is_junction())) return;
        const std::vector<std::int32_t> gone = shared_;
        if (!may_merge(a, b, gone)) return;
        Vec p = at(a);
        if (kind_[a] == kind_[b]) p = kind_[a] == inner ? keeping_volume(a, b) : 0.5 * (at(a) + at(b));
        if (!fits(a, b, p, wanted_length(a, b)) || !stays_apart(a, b, p)) return;
        if (kind_[a] == kind_[b]) {
            s_.length[a] = wanted_length(a, b);
            for (std::size_t k = 0; k < s_.columns; ++k) {
                double& own = s_.carried[a * s_.columns + k];
                own = (own + s_.carried[b * s_.columns + k]) / 2;
            }
        }
        s_.position[a] = p;
        for (std::int32_t f : gone) remove(f);
        for (std::int32_t f : faces_of_[b]) {
            std::replace(s_.face[f].begin(), s_.face[f].end(), b, a);
            faces_of_[a].push_back(f);
        }
        faces_of_[b].clear();
        alive_[b] = 0;
        for (std::int32_t f : faces_of_[a]) renew(f);
        ++counts_.collapses;
    }

    bool may_merge(std::int32_t a, std::int32_t b, const std::vector<std::int32_t>& gone) {
        const std::int64_t near_a = ++time_;
        for (std::int32_t f : faces_of_[a])
            for (std::int32_t w : s_.face[f]) stamp_[w] = near_a;
        std::vector<std::int32_t> common;
        for (std::int32_t f : faces_of_[b])
            for (std::int32_t w : s_.face[f])
                if (w != a && w != b && stamp_[w] == near_a) {
                    stamp_[w] = 0;
                    common.push_back(w);
                }
        if (common.size() != gone.size()) return false;  // the link condition
        if (faces_of_[a].size() + faces_of_[b].size() < 2 * gone.size() + 3) return false;
        for (std::int32_t w : common) {
            if (faces_of_[w].size() < 4 && kind_[w] == inner) return false;
            if (kind_[b] == line && is_junction(a, w) && is_junction(b, w)) return false;
        }
        for (std::int32_t f : faces_of_[b]) {  // no two faces on the same three vertices
            if (has(f, a)) continue;
            Face c = s_.face[f];
            std::replace(c.begin(), c.end(), b, a);
            for (std::int32_t g : faces_of_[a])
                if (!has(g, b) && has(g, c[0]) && has(g, c[1]) && has(g, c[2])) return false;
        }
        return true;
    }

    // Near the middle of an edge within a surface, where merging its ends leaves the volume as it is.
    Vec keeping_volume(std::int32_t a, std::int32_t b) const {
        const Vec o = 0.5 * (at(a) + at(b));
        double before = 0;
        Vec g{0, 0, 0};
        for (std::int32_t v : {a, b})
            for (std::int32_t f : faces_of_[v]) {
                const bool both = has(f, a) && has(f, b);
                if (both && v == b) continue;
                const Face& c = s_.face[f];
                before += dot(at(c[0]) - o, cross(at(c[1]) - o, at(c[2]) - o));
                if (both) continue;
                const int k = c[0] == v ? 0 : c[1] == v ? 1 : 2;
                g = g + cross(at(c[(k + 1) % 3]) - o, at(c[(k + 2) % 3]) - o);
            }
        const double square = dot(g, g);
        if (!(square > 0)) return o;
        const Vec shift = (before / square) * g;
        return norm(shift) < 0.4 * norm(at(b) - at(a)) ? o + shift : o;
    }

    // Whether the faces around a and b stay well shaped and unturned if both lie at p.
    bool fits(std::int32_t a, std::int32_t b, Vec p, double wanted) const {
        double worst_before = 1, worst_after = 1;
        for (std::int32_t v : {a, b})
            for (std::int32_t f : faces_of_[v]) {
                const Face& c = s_.face[f];
                worst_before = std::min(worst_before, quality(at(c[0]), at(c[1]), at(c[2])));
                if (has(f, a) && has(f, b)) continue;
                std::array<Vec, 3> q{};
                for (int k = 0; k < 3; ++k) q[k] = c[k] == v ? p : at(c[k]);
                if (turns(area_vector(c), cross(q[1] - q[0], q[2] - q[0]))) return false;
                worst_after = std::min(worst_after, quality(q[0], q[1], q[2]));
                for (int k = 0; k < 3; ++k)
                    if (norm(q[k] - q[(k + 1) % 3]) > too_long * wanted) return false;
            }
        return worst_after >= std::min(worst_before, good_enough);
    }

    static bool turns(Vec before, Vec after) {
        const double lengths = norm(before) * norm(after);
        return norm(before) > 0 && !(dot(before, after) > turned * lengths);
    }

    void remove(std::int32_t f) {
        for (std::int32_t v : s_.face[f]) {
            auto& own = faces_of_[v];
            own.erase(std::find(own.begin(), own.end(), f));
        }
        s_.face[f] = {-1, -1, -1};
        forget(f);
    }

    // -------------------------------------------------------------------------------- flip

    void flip_all() {
        for (const Edge& e : edges([](const Edge&) { return true; })) flip(e.a, e.b);
    }

    void flip(std::int32_t a, std::int32_t b) {
        if (is_sealed(a, b)) return;
        find_shared(a, b);
        if (is_junction()) return;
        std::int32_t f = shared_[0], g = shared_[1];
        if (!runs(f, a, b)) std::swap(f, g);
        if (!runs(f, a, b) || !runs(g, b, a)) return;  // wound against each other
        const std::int32_t c = opposite(f, a, b), d = opposite(g, a, b);
        if (c == d || faces_of_[a].size() < 4 || faces_of_[b].size() < 4) return;
        const Vec pa = at(a), pb = at(b), pc = at(c), pd = at(d);
        // Delaunay: the two angles opposite the edge add up to more than half a turn.
        const double cos_c = dot(pa - pc, pb - pc), sin_c = norm(cross(pa - pc, pb - pc));
        const double cos_d = dot(pa - pd, pb - pd), sin_d = norm(cross(pa - pd, pb - pd));
        if (!(sin_c * cos_d + cos_c * sin_d < -1e-9 * (std::abs(cos_c * cos_d) + sin_c * sin_d))) return;
        const Vec nf = cross(pb - pa, pc - pa), ng = cross(pa - pb, pd - pb);
        const bool slivers = std::min(quality(pa, pb, pc), quality(pb, pa, pd)) < 0.05;
        if (!slivers && dot(nf, ng) < flat * norm(nf) * norm(ng)) return;
        const Vec n1 = cross(pd - pa, pc - pa), n2 = cross(pb - pd, pc - pd), mean = nf + ng;
        if (turns(mean, n1) || turns(mean, n2)) return;
        if (std::min(quality(pa, pd, pc), quality(pd, pb, pc)) <= std::min(quality(pa, pb, pc), quality(pb, pa, pd)))
            return;
        bool joined = false;
        for (std::int32_t h : faces_of_[c]) joined = joined || has(h, d);
        if (joined) return;
        if (!may_flip(f, g, a, b, {{a, d, c}, {pa, pd, pc}}, {{d, b, c}, {pd, pb, pc}})) return;
        s_.face[f] = {a, d, c};
        s_.face[g] = {d, b, c};
        drop(b, f);
        drop(a, g);
        faces_of_[d].push_back(f);
        faces_of_[c].push_back(g);
        renew(f);
        renew(g);
        ++counts_.flips;
    }

    bool runs(std::int32_t f, std::int32_t a, std::int32_t b) const {
        const Face& c = s_.face[f];
        return (c[0] == a && c[1] == b) || (c[1] == a && c[2] == b) || (c[2] == a && c[0] == b);
    }

    void drop(std::int32_t v, std::int32_t f) {
        auto& own = faces_of_[v];
        own.erase(std::find(own.begin(), own.end(), f));
    }

    // -------------------------------------------------------------------------------- move

    void move_all() {
        for (std::int32_t v = 0; v < static_cast<std::int32_t>(s_.position.size()); ++v) {
            if (!alive_[v] || kind_[v] == corner || faces_of_[v].empty()) continue;
            Vec step = kind_[v] == inner ? within_surface(v) : along_junction(v);
            for (int tries = 0; tries < 3; ++tries, step = 0.5 * step)
                if (fits(v, v, at(v) + step) && stays_apart(v, v, at(v) + step)) {
                    s_.position[v] = at(v) + step;
                    for (std::int32_t f : faces_of_[v]) renew(f);
                    break;
                }
        }
    }

    // Towards the mean of the faces around, weighted by area; across the sum of their area vectors,
    // as a step along it is what changes the volume.
    Vec within_surface(std::int32_t v) const {
        Vec mean{0, 0, 0}, normal{0, 0, 0};
        double total = 0;
        for (std::int32_t f : faces_of_[v]) {
            const Face& c = s_.face[f];
            const Vec n = area_vector(c);
            const double area = norm(n);
            mean = mean + (area / 3) * (at(c[0]) + at(c[1]) + at(c[2]));
            normal = normal + n;
            total += area;
        }
        if (!(total > 0)) return {0, 0, 0};
        const Vec step = pace * ((1 / total) * mean - at(v));
        const double square = dot(normal, normal);
        return square > 0 ? step - (dot(step, normal) / square) * normal : step;
    }

    Vec along_junction(std::int32_t v) {
        std::vector<std::int32_t> around, ends;
        for_neighbours(v, [&](std::int32_t w) { around.push_back(w); });
        for (std::int32_t w : around)
            if (is_junction(v, w)) ends.push_back(w);
        if (ends.size() != 2) return {0, 0, 0};
        const Vec chord = at(ends[1]) - at(ends[0]);
        const double square = dot(chord, chord);
        if (!(square > 0)) return {0, 0, 0};
        const Vec to_middle = 0.5 * (at(ends[0]) + at(ends[1])) - at(v);
        return (pace * dot(to_middle, chord) / square) * chord;
    }

    bool fits(std::int32_t v, std::int32_t, Vec p) const {
        double before = 1, after = 1;
        for (std::int32_t f : faces_of_[v]) {
            const Face& c = s_.face[f];
            before = std::min(before, quality(at(c[0]), at(c[1]), at(c[2])));
            std::array<Vec, 3> q{};
            for (int k = 0; k < 3; ++k) q[k] = c[k] == v ? p : at(c[k]);
            if (turns(area_vector(c), cross(q[1] - q[0], q[2] - q[0]))) return false;
            after = std::min(after, quality(q[0], q[1], q[2]));
        }
        return after >= std::min(before, good_enough);
    }
};

}  // namespace

Counts remesh(Surface& surface, int passes, bool smooth, double apart) {
    return Remesher(surface).run(passes, smooth, apart);
}

}  // namespace deltamic_remesh
