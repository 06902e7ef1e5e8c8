#include "remesh.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "crossing.h"

namespace deltamic_remesh {
namespace {

constexpr double too_long = 4.0 / 3, too_short = 4.0 / 5;  // of the wanted length
constexpr double turned = 0.5;       // cosine up to which an operation may turn a face
constexpr double flat = 0.8;         // cosine between two faces whose diagonal may be flipped
constexpr double good_enough = 0.3;  // quality (1: equilateral) that no operation may go below
constexpr double pace = 0.5;         // share of the way that a vertex moves to its place in a pass

enum Kind : char { inner, line, corner };  // within a surface; on a junction; where junctions meet

using Face = std::array<std::int32_t, 3>;
struct Edge {
    std::int32_t a, b;
    double length;
};

class Remesher {
public:
    explicit Remesher(Surface& s) : s_(s), faces_of_(s.position.size()), alive_(s.position.size(), 1) {
        for (std::size_t f = 0; f < s_.face.size(); ++f) {
            if (s_.region[f][0] < s_.region[f][1]) {
                std::swap(s_.region[f][0], s_.region[f][1]);
                std::swap(s_.face[f][1], s_.face[f][2]);
            }
            for (std::int32_t v : s_.face[f]) faces_of_[v].push_back(static_cast<std::int32_t>(f));
        }
        stamp_.assign(s.position.size(), 0);
        find_kinds();
    }

    Counts run(int passes, bool smooth, bool apart) {
        if (apart) sort_in();
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
    Surface& s_;
    std::vector<std::vector<std::int32_t>> faces_of_;
    std::vector<char> alive_;
    std::vector<Kind> kind_;
    std::vector<std::int64_t> stamp_;
    std::int64_t time_ = 0;
    std::vector<std::int32_t> shared_;  // faces of the edge at hand
    Counts counts_;
    std::unique_ptr<FaceGrid> grid_;     // where the faces lie; only if they are kept from crossing
    std::vector<std::int64_t> aside_;    // the time at which a face was last left out of a check

    Vec at(std::int32_t v) const { return s_.position[v]; }
    bool has(std::int32_t f, std::int32_t v) const {
        const Face& c = s_.face[f];
        return c[0] == v || c[1] == v || c[2] == v;
    }
    std::int32_t opposite(std::int32_t f, std::int32_t a, std::int32_t b) const {
        const Face& c = s_.face[f];
        return c[0] != a && c[0] != b ? c[0] : c[1] != a && c[1] != b ? c[1] : c[2];
    }
    Vec area_vector(const Face& c) const { return cross(at(c[1]) - at(c[0]), at(c[2]) - at(c[0])); }

    // 1 for an equilateral triangle, 0 for one without area.
    static double quality(Vec a, Vec b, Vec c) {
        const Vec u = b - a, v = c - a, w = c - b;
        const double edges = dot(u, u) + dot(v, v) + dot(w, w);
        return edges > 0 ? 2 * std::sqrt(3.0) * norm(cross(u, v)) / edges : 0;
    }

    // Faces of an edge, into shared_.
    void find_shared(std::int32_t a, std::int32_t b) {
        shared_.clear();
        for (std::int32_t f : faces_of_[a])
            if (has(f, b)) shared_.push_back(f);
    }

    // Whether the faces in shared_ meet in a junction (or the border of an open surface).
    bool is_junction() const {
        return shared_.size() != 2 || s_.region[shared_[0]] != s_.region[shared_[1]];
    }
    bool is_junction(std::int32_t a, std::int32_t b) {
        find_shared(a, b);
        return is_junction();
    }

    // ------------------------------------------------------------------------------- apart

    Placed placed(std::int32_t f) const {
        const Face& c = s_.face[f];
        return {c, {at(c[0]), at(c[1]), at(c[2])}};
    }

    void sort_in() {
        if (s_.position.empty()) return;
        Box all = Box::around(at(0));
        for (const Vec& p : s_.position) all.take(Box::around(p));
        double side = 0;
        for (double l : s_.length) side += l / static_cast<double>(s_.length.size());
        grid_ = std::make_unique<FaceGrid>(all, side, s_.face.size());
        for (std::size_t f = 0; f < s_.face.size(); ++f) sort_in(static_cast<std::int32_t>(f));
    }
    void sort_in(std::int32_t f) {
        if (grid_) grid_->put(f, placed(f).box());
    }

    // Whether the faces of a and b, if they become these, cross no others nor each other.
    bool stays_apart(std::int32_t a, std::int32_t b, const std::vector<Placed>& planned) {
        const std::int64_t now = ++time_;
        aside_.resize(s_.face.size(), 0);
        for (std::int32_t v : {a, b})
            for (std::int32_t f : faces_of_[v]) aside_[f] = now;
        for (std::size_t i = 0; i < planned.size(); ++i) {
            const auto crossed = [&](std::int32_t f) { return aside_[f] != now && planned[i].crosses(placed(f)); };
            if (grid_->any(planned[i].box(), crossed)) return false;
            for (std::size_t k = 0; k < i; ++k)
                if (planned[i].crosses(planned[k])) return false;
        }
        return true;
    }
    // The same if a and b both lie at p and the faces that have both are gone.
    bool stays_apart(std::int32_t a, std::int32_t b, Vec p) {
        if (!grid_) return true;
        std::vector<Placed> planned;
        for (std::int32_t v : {a, b}) {
            for (std::int32_t f : faces_of_[v]) {
                if (a != b && has(f, a) && has(f, b)) continue;
                planned.push_back(placed(f));
                for (int k = 0; k < 3; ++k)
                    if (planned.back().vertex[k] == v) planned.back().vertex[k] = a, planned.back().corner[k] = p;
            }
            if (a == b) break;
        }
        return stays_apart(a, b, planned);
    }

    // --------------------------------------------------------------------------- neighbours

    template <class F>
    void for_neighbours(std::int32_t v, F&& f) {
        const std::int64_t now = ++time_;
        stamp_[v] = now;
        for (std::int32_t g : faces_of_[v])
            for (std::int32_t w : s_.face[g])
                if (stamp_[w] != now) {
                    stamp_[w] = now;
                    f(w);
                }
    }

    template <class F>
    std::vector<Edge> edges(F&& wanted) {
        std::vector<Edge> found;
        for (std::int32_t a = 0; a < static_cast<std::int32_t>(s_.position.size()); ++a) {
            if (!alive_[a]) continue;
            for_neighbours(a, [&](std::int32_t b) {
                if (b < a) return;
                const Edge e{a, b, norm(at(b) - at(a))};
                if (wanted(e)) found.push_back(e);
            });
        }
        return found;
    }
    double wanted_length(std::int32_t a, std::int32_t b) const { return (s_.length[a] + s_.length[b]) / 2; }

    void find_kinds() {
        kind_.assign(s_.position.size(), inner);
        std::vector<int> junctions(s_.position.size(), 0);
        for (const Edge& e : edges([](const Edge&) { return true; }))
            if (is_junction(e.a, e.b)) ++junctions[e.a], ++junctions[e.b];
        for (std::size_t v = 0; v < kind_.size(); ++v)
            kind_[v] = s_.fixed[v] || (junctions[v] != 0 && junctions[v] != 2) ? corner : junctions[v] ? line : inner;
    }

    // ------------------------------------------------------------------------------- split

    void split_all() {
        std::vector<Edge> found = edges([&](const Edge& e) { return e.length > too_long * wanted_length(e.a, e.b); });
        std::sort(found.begin(), found.end(), [](const Edge& p, const Edge& q) { return p.length > q.length; });
        for (const Edge& e : found) split(e.a, e.b);
    }

    void split(std::int32_t a, std::int32_t b) {
        find_shared(a, b);
        const bool junction = is_junction();
        const auto m = static_cast<std::int32_t>(s_.position.size());
        s_.position.push_back(0.5 * (at(a) + at(b)));
        s_.length.push_back(wanted_length(a, b));
        s_.fixed.push_back(s_.fixed[a] && s_.fixed[b]);
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
            sort_in(f);
            sort_in(g);
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
        for (std::int32_t f : faces_of_[a]) sort_in(f);
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
        if (grid_) grid_->take_out(f);
    }

    // -------------------------------------------------------------------------------- flip

    void flip_all() {
        for (const Edge& e : edges([](const Edge&) { return true; })) flip(e.a, e.b);
    }

    void flip(std::int32_t a, std::int32_t b) {
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
        if (grid_ && !may_flip(f, g, {{a, d, c}, {pa, pd, pc}}, {{d, b, c}, {pd, pb, pc}})) return;
        s_.face[f] = {a, d, c};
        s_.face[g] = {d, b, c};
        drop(b, f);
        drop(a, g);
        faces_of_[d].push_back(f);
        faces_of_[c].push_back(g);
        sort_in(f);
        sort_in(g);
        ++counts_.flips;
    }

    // Whether two new faces cross none but those that they replace.
    bool may_flip(std::int32_t f, std::int32_t g, const Placed& one, const Placed& other) const {
        for (const Placed* planned : {&one, &other})
            if (grid_->any(planned->box(), [&](std::int32_t h) { return h != f && h != g && planned->crosses(placed(h)); }))
                return false;
        return true;
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
                    for (std::int32_t f : faces_of_[v]) sort_in(f);
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

    // -------------------------------------------------------------------------------- pack

    void pack() {
        std::vector<std::int32_t> place(s_.position.size(), -1);
        std::int32_t n = 0;
        for (std::size_t v = 0; v < s_.position.size(); ++v) {
            if (!alive_[v] || faces_of_[v].empty()) continue;
            place[v] = n;
            s_.position[n] = s_.position[v];
            s_.length[n] = s_.length[v];
            s_.fixed[n] = s_.fixed[v];
            for (std::size_t k = 0; k < s_.columns; ++k) s_.carried[n * s_.columns + k] = s_.carried[v * s_.columns + k];
            ++n;
        }
        s_.position.resize(n);
        s_.length.resize(n);
        s_.fixed.resize(n);
        s_.carried.resize(n * s_.columns);
        std::size_t m = 0;
        for (std::size_t f = 0; f < s_.face.size(); ++f) {
            if (s_.face[f][0] < 0) continue;
            for (int k = 0; k < 3; ++k) s_.face[m][k] = place[s_.face[f][k]];
            s_.region[m] = s_.region[f];
            ++m;
        }
        s_.face.resize(m);
        s_.region.resize(m);
    }
};

}  // namespace

Counts remesh(Surface& surface, int passes, bool smooth, bool apart) {
    return Remesher(surface).run(passes, smooth, apart);
}

}  // namespace deltamic_remesh
