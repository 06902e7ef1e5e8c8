// A surface and, of each vertex, the faces around it; on request also where its faces lie, so that
// changes that would make them cross are known before they are made.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "crossing.h"
#include "remesh.h"

namespace deltamic_remesh {

enum Kind : char { inner, line, corner };  // within a surface; on a junction; where junctions meet

using Face = std::array<std::int32_t, 3>;
struct Edge {
    std::int32_t a, b;
    double length;
};

class LinkedSurface {
protected:
    explicit LinkedSurface(Surface& s) : s_(s), faces_of_(s.position.size()), alive_(s.position.size(), 1) {
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

    Surface& s_;
    std::vector<std::vector<std::int32_t>> faces_of_;
    std::vector<char> alive_;
    std::vector<Kind> kind_;
    std::vector<std::int64_t> stamp_;
    std::int64_t time_ = 0;
    std::vector<std::int32_t> shared_;  // faces of the edge at hand


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

    bool is_sealed(std::int32_t a, std::int32_t b) const { return s_.fixed[a] == sealed && s_.fixed[b] == sealed; }

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

    // --------------------------------------------------------- kept from crossing

    Placed placed(std::int32_t f) const {
        const Face& c = s_.face[f];
        return {c, {at(c[0]), at(c[1]), at(c[2])}};
    }

    void sort_in(double apart) {
        if (s_.position.empty()) return;
        near_ = apart;
        Box all = Box::around(at(0));
        for (const Vec& p : s_.position) all.take(Box::around(p));
        double side = 0;
        for (double l : s_.length) side += l / static_cast<double>(s_.length.size());
        grid_ = std::make_unique<FaceGrid>(all, side, s_.face.size());
        for (std::size_t f = 0; f < s_.face.size(); ++f) renew(static_cast<std::int32_t>(f));
    }
    void renew(std::int32_t f) {
        if (!grid_) return;
        const Face& c = s_.face[f];
        if (s_.guard[c[0]] || s_.guard[c[1]] || s_.guard[c[2]]) grid_->put(f, placed(f).box(near_ / 2));
        else grid_->take_out(f);
    }

    void forget(std::int32_t f) {
        if (grid_) grid_->take_out(f);
    }

    // Whether the faces of a and b, if they become these, cross no others nor each other.
    bool stays_apart(std::int32_t a, std::int32_t b, const std::vector<Placed>& planned) {
        const std::int64_t now = ++time_;
        aside_.resize(s_.face.size(), 0);
        for (std::int32_t v : {a, b})
            for (std::int32_t f : faces_of_[v]) aside_[f] = now;
        for (std::size_t i = 0; i < planned.size(); ++i) {
            const auto crossed = [&](std::int32_t f) {
                return aside_[f] != now && planned[i].crosses(placed(f), near_);
            };
            if (grid_->any(planned[i].box(near_ / 2), crossed)) return false;
            for (std::size_t k = 0; k < i; ++k)
                if (planned[i].crosses(planned[k], near_)) return false;
        }
        return true;
    }
    // The same if a and b both lie at p and the faces that have both are gone.
    bool stays_apart(std::int32_t a, std::int32_t b, Vec p) {
        if (!grid_ || (s_.guard[a] != guarded && s_.guard[b] != guarded)) return true;
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

    // Whether two new faces cross none but those at the edge a, b that they replace.
    bool may_flip(std::int32_t f, std::int32_t g, std::int32_t a, std::int32_t b, const Placed& one,
                  const Placed& other) const {
        if (!grid_ || (s_.guard[a] != guarded && s_.guard[b] != guarded)) return true;
        for (const Placed* planned : {&one, &other})
            if (grid_->any(planned->box(near_ / 2), [&](std::int32_t h) {
                    return h != f && h != g && planned->crosses(placed(h), near_);
                }))
                return false;
        return true;
    }

    // Leaves out what is not used any more.
    void pack() {
        std::vector<std::int32_t> place(s_.position.size(), -1);
        std::int32_t n = 0;
        for (std::size_t v = 0; v < s_.position.size(); ++v) {
            if (!alive_[v] || faces_of_[v].empty()) continue;
            place[v] = n;
            s_.position[n] = s_.position[v];
            s_.length[n] = s_.length[v];
            s_.fixed[n] = s_.fixed[v];
            s_.origin[n] = s_.origin[v];
            for (std::size_t k = 0; k < s_.columns; ++k) s_.carried[n * s_.columns + k] = s_.carried[v * s_.columns + k];
            ++n;
        }
        s_.position.resize(n);
        s_.length.resize(n);
        s_.fixed.resize(n);
        s_.origin.resize(n);
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

private:
    std::unique_ptr<FaceGrid> grid_;     // where the faces lie; only if they are kept from crossing
    double near_ = 0;                    // faces as near as this cross
    std::vector<std::int64_t> aside_;    // the time at which a face was last left out of a check
};

}  // namespace deltamic_remesh
