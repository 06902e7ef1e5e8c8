#include "proximity.h"

#include <algorithm>
#include <cmath>

#include "boxes.h"
#include "crossing.h"

namespace deltamic_remesh {
namespace {

constexpr double share_of_room = 0.49;  // of the distance of a pair that each of its sides may use
constexpr double safe = 0.9;            // of the distance that a pair may come nearer without a look
constexpr double as_good_as_still = 0.1;  // motion of a pair, of its distance, that is taken off without a look
constexpr double gap = 0.1;             // of the distance that is left where a pair collides
constexpr int looks = 200;              // of the continuous test; what takes more counts as colliding
constexpr int rounds = 3;               // of shortening; what still collides then stays where it was
constexpr int rounds_at_most = 60;      // then nothing that was looked at moves
constexpr double looks_per_pair = 50;   // on the mean; then what is not known to be free stays
// Where parts lie so dense that there are more in a cell, the search is repeated with smaller balls
// and finer cells; what is still crowded then stays where it was.
constexpr std::size_t crowd = 512;
constexpr std::array<double, 2> reaches{1, 0.1};
constexpr double finer_at_last = 4;
constexpr std::size_t pairs_per_part = 100;  // on the mean; the same if there are more

using Four = std::array<Vec, 4>;

double distance(const Four& q, bool edges) {
    if (edges) return std::sqrt(squared_between_segments(q[0], q[1], q[2], q[3]));
    return norm(q[0] - nearest_in_triangle(q[0], q[1], q[2], q[3]));
}

// How far the two sides of a pair move at most, together; what all do alike does not count.
double approach(const Four& step, bool edges) {
    const Vec mean = 0.25 * (step[0] + step[1] + step[2] + step[3]);
    std::array<double, 4> n{};
    for (int k = 0; k < 4; ++k) n[k] = dot(step[k] - mean, step[k] - mean);
    const double one = edges ? std::max(n[0], n[1]) : n[0];
    const double other = edges ? std::max(n[2], n[3]) : std::max({n[1], n[2], n[3]});
    return std::sqrt(one) + std::sqrt(other);
}

// The share of a step after which a pair has come as near as the gap; above 1 if it does not.
double time_to_gap(Four place, const Four& step, double near, bool edges, std::int64_t& looks_left) {
    const double most = approach(step, edges), aim = gap * near;
    double time = 0;
    for (int k = 0; k < looks; ++k) {
        if (--looks_left < 0) return 0;
        const double now = time == 0 ? near : distance(place, edges);
        if (time > 0 && now < aim) return time;
        const double on = safe * (now - (time == 0 ? 0.0 : 0.5 * aim)) / most;
        if (time + on > 1) return 2;
        time += on;
        for (int i = 0; i < 4; ++i) place[i] = place[i] + on * step[i];
    }
    return time;
}

template <class One, class Other>
bool share_a_vertex(const One& one, const Other& other) {
    for (std::int32_t v : one)
        for (std::int32_t w : other)
            if (v == w) return true;
    return false;
}

// Whether a direction keeps the two sides of a pair apart, all along the step, by more than any of
// its vertices needs. Most pairs of neighbours in a surface lie like that; boxes cannot tell.
class Apart {
public:
    Apart(const std::vector<Vec>& start, const std::vector<Vec>& end, const std::vector<double>& needed)
        : start_(start), end_(end), needed_(needed) {}

    template <class One, class Other>
    bool operator()(const One& one, const Other& other) const {
        const Vec along = middle(other) - middle(one);
        const double length = norm(along);
        double least = INFINITY, most = -INFINITY, room = 0;
        for (std::int32_t v : other) {
            least = std::min({least, dot(along, start_[v]), dot(along, end_[v])});
            room = std::max(room, needed_[v]);
        }
        for (std::int32_t v : one) {
            most = std::max({most, dot(along, start_[v]), dot(along, end_[v])});
            room = std::max(room, needed_[v]);
        }
        return least - most > (1 + 1e-9) * room * length;
    }

private:
    template <class Corners>
    Vec middle(const Corners& corners) const {
        Vec sum{0, 0, 0};
        for (std::int32_t v : corners) sum = sum + start_[v];
        return (1.0 / static_cast<double>(corners.size())) * sum;
    }

    const std::vector<Vec>&start_, &end_;
    const std::vector<double>& needed_;
};

template <class Corners>
std::vector<Box> joined(const std::vector<Box>& points, const std::vector<Corners>& elements) {
    std::vector<Box> boxes(elements.size());
    for (std::size_t i = 0; i < elements.size(); ++i) {
        boxes[i] = points[elements[i][0]];
        for (std::size_t k = 1; k < elements[i].size(); ++k) boxes[i].take(points[elements[i][k]]);
    }
    return boxes;
}

template <class Corners>
std::vector<char> any_of(const std::vector<char>& active, const std::vector<Corners>& elements) {
    std::vector<char> found(elements.size());
    for (std::size_t i = 0; i < elements.size(); ++i)
        for (std::int32_t v : elements[i]) found[i] = found[i] || active[v];
    return found;
}

}  // namespace

std::vector<Two> crossings(const std::vector<Vec>& place, const std::vector<Two>& edges,
                           const std::vector<Triple>& faces, double near) {
    std::vector<Box> points(place.size());
    for (std::size_t v = 0; v < place.size(); ++v) points[v] = Box::around(place[v]), points[v].grow(near / 2);
    const std::vector<Box> along = joined(points, edges), over = joined(points, faces);
    const std::vector<char> every_edge(edges.size(), 1), every_face(faces.size(), 1);
    std::vector<Two> found;
    const auto related = [&](std::int32_t e, std::int32_t f) { return share_a_vertex(edges[e], faces[f]); };
    BoxGrid(along, over, every_edge, every_face).overlaps(related, [&](std::int32_t e, std::int32_t f) {
        const auto& [a, b] = edges[e];
        const auto& [p, q, r] = faces[f];
        if (meets(place[a], place[b], place[p], place[q], place[r], near)) found.push_back({e, f});
    });
    return found;
}

std::vector<Near> near_faces(const std::vector<Vec>& points, const std::vector<Vec>& place,
                             const std::vector<Triple>& faces, double reach) {
    std::vector<Box> corners(place.size()), around(points.size());
    for (std::size_t v = 0; v < place.size(); ++v) corners[v] = Box::around(place[v]);
    for (std::size_t i = 0; i < points.size(); ++i) {
        around[i] = Box::around(points[i]);
        around[i].grow(reach);
    }
    const std::vector<Box> over = joined(corners, faces);
    const std::vector<char> every_point(points.size(), 1), every_face(faces.size(), 1);
    std::vector<Near> found;
    const auto related = [](std::int32_t, std::int32_t) { return false; };
    BoxGrid(around, over, every_point, every_face).overlaps(related, [&](std::int32_t i, std::int32_t f) {
        const auto& [a, b, c] = faces[f];
        const Vec p = nearest_in_triangle(points[i], place[a], place[b], place[c]);
        if (norm(points[i] - p) <= reach) found.push_back({i, f, p});
    });
    return found;
}

Guard::Guard(std::vector<Two> edges, std::vector<Triple> faces, std::vector<double> near, double contact, double touch,
             std::vector<std::int32_t> wall, std::vector<std::uint8_t> unguarded)
    : edges_(std::move(edges)), faces_(std::move(faces)), near_(std::move(near)), contact_(contact),
      touch_(touch), wall_(std::move(wall)), unguarded_(std::move(unguarded)), center_(near_.size(), Vec{0, 0, 0}),
      radius_(near_.size(), -1) {
    walls_ = static_cast<std::size_t>(std::lround(std::sqrt(static_cast<double>(unguarded_.size()))));
    if (!walls_) return;
    walls_of_vertex_.resize(near_.size());
    for (std::size_t f = 0; f < faces_.size(); ++f)
        for (std::int32_t v : faces_[f]) {
            auto& own = walls_of_vertex_[v];
            if (std::find(own.begin(), own.end(), wall_[f]) == own.end()) own.push_back(wall_[f]);
        }
    for (const Two& e : edges_) {
        walls_of_edge_.emplace_back();
        for (std::int32_t w : walls_of_vertex_[e[0]]) {
            const auto& other = walls_of_vertex_[e[1]];
            if (std::find(other.begin(), other.end(), w) != other.end()) walls_of_edge_.back().push_back(w);
        }
    }
}

bool Guard::left_alone(const std::vector<std::int32_t>& a, const std::vector<std::int32_t>& b) const {
    for (std::int32_t p : a)
        for (std::int32_t q : b)
            if (unguarded_[p * walls_ + q]) return true;
    return false;
}

bool Guard::pairs(const std::vector<Vec>& start, const std::vector<Vec>& end, const std::vector<char>& active,
                  double reach, std::vector<Pair>& found, std::vector<char>& refused) {
    std::vector<Box> points(start.size());
    std::vector<double> needed(start.size());  // distance of a pair from which on it says nothing of v
    for (std::size_t v = 0; v < start.size(); ++v) {
        points[v] = Box::around(active[v] ? start[v] : center_[v]);
        if (active[v]) points[v].take(Box::around(end[v]));
        points[v].grow(active[v] ? share_of_room * reach * near_[v] : radius_[v]);  // its ball, now or soon
        needed[v] = active[v] ? reach * near_[v] : (radius_[v] + norm(end[v] - center_[v])) / share_of_room;
    }
    const Apart apart(start, end, needed);
    const std::vector<Box> along = joined(points, edges_), over = joined(points, faces_);
    const std::vector<char> active_edges = any_of(active, edges_), active_faces = any_of(active, faces_);
    found.clear();
    refused.assign(start.size(), 0);
    bool all = true;
    const auto refuse = [&](const auto& vertices) {
        for (std::int32_t v : vertices) refused[v] = 1;
        all = false;
    };
    const std::size_t most = pairs_per_part * (start.size() + edges_.size() + faces_.size());
    const double finer = reach < 1 ? finer_at_last : 1;
    BoxGrid to_faces(points, over, active, active_faces, finer);
    BoxGrid to_edges(along, along, active_edges, active_edges, finer);
    to_faces.overlaps(
        [&](std::int32_t v, std::int32_t f) { return share_a_vertex(Triple{v, v, v}, faces_[f]); },
        [&](std::int32_t v, std::int32_t f) {
            if (found.size() == most || apart(std::array<std::int32_t, 1>{v}, faces_[f])) return;
            if (walls_ && left_alone(walls_of_vertex_[v], {wall_[f]})) return;
            const auto& [a, b, c] = faces_[f];
            found.push_back({{v, a, b, c}, false});
        },
        crowd,
        [&](std::int32_t v, std::int32_t f) { f < 0 ? refuse(std::array<std::int32_t, 1>{v}) : refuse(faces_[f]); });
    to_edges.overlaps(
        [&](std::int32_t e, std::int32_t g) { return share_a_vertex(edges_[e], edges_[g]); },
        [&](std::int32_t e, std::int32_t g) {
            if (found.size() == most || apart(edges_[e], edges_[g])) return;
            if (walls_ && left_alone(walls_of_edge_[e], walls_of_edge_[g])) return;
            found.push_back({{edges_[e][0], edges_[e][1], edges_[g][0], edges_[g][1]}, true});
        },
        crowd, [&](std::int32_t e, std::int32_t) { refuse(edges_[e]); });
    work += static_cast<std::int64_t>(to_faces.tests + to_edges.tests);
    if (found.size() == most) {
        found.clear();
        std::fill(refused.begin(), refused.end(), 1);
        all = false;
    }
    return all;
}

void Guard::shorten(const std::vector<Pair>& near, const std::vector<double>& distances, const std::vector<Vec>& start,
                    const std::vector<Vec>& end, std::vector<double>& share) {
    const auto all_looks = static_cast<std::int64_t>(looks_per_pair * static_cast<double>(near.size()));
    std::int64_t looks_left = all_looks;
    std::vector<char> changed(start.size(), 1), lower(start.size(), 0);
    for (int turn = 0;; ++turn) {
        std::vector<double> may = share;
        bool any = false;
        std::fill(lower.begin(), lower.end(), 0);
        for (std::size_t i = 0; i < near.size(); ++i) {
            const auto& v = near[i].v;
            if (!(changed[v[0]] || changed[v[1]] || changed[v[2]] || changed[v[3]])) continue;
            Four place{}, step{};
            for (int k = 0; k < 4; ++k) {
                place[k] = start[v[k]];
                step[k] = share[v[k]] * (end[v[k]] - start[v[k]]);
            }
            const double most = approach(step, near[i].edges);
            if (most < safe * distances[i]) continue;
            if (distances[i] <= touch_) continue;
            double time = time_to_gap(place, step, distances[i], near[i].edges, looks_left);
            if (time > 1) continue;
            if (distances[i] < contact_ || turn >= rounds) time = 0;
            any = true;
            for (std::int32_t w : v) {
                lower[w] = 1;
                may[w] = std::min(may[w], turn >= rounds_at_most ? 0.0 : time * share[w]);
            }
        }
        if (!any) break;
        if (turn >= rounds_at_most) {
            for (const Pair& p : near)
                for (std::int32_t w : p.v) may[w] = 0, lower[w] = 1;
        }
        share.swap(may);
        changed.swap(lower);
        if (turn > rounds_at_most) break;
    }
    work += all_looks - std::max<std::int64_t>(looks_left, 0);
}

std::int64_t Guard::limit(const std::vector<Vec>& start, std::vector<Vec>& end) {
    std::vector<char> active(start.size(), 0);
    std::int64_t leaving = 0;
    for (std::size_t v = 0; v < start.size(); ++v) {
        active[v] = radius_[v] < 0 || norm(end[v] - center_[v]) > radius_[v] || norm(start[v] - center_[v]) > radius_[v];
        leaving += active[v];
    }
    if (!leaving) return 0;
    renewed += leaving;
    std::vector<Pair> near;
    std::vector<char> refused;
    double reach = 1;
    for (double r : reaches) {
        reach = r;
        if (pairs(start, end, active, reach, near, refused)) break;
    }
    std::vector<double> apart(near.size());
    for (std::size_t i = 0; i < near.size(); ++i) {
        Four place{};
        for (int k = 0; k < 4; ++k) place[k] = start[near[i].v[k]];
        apart[i] = distance(place, near[i].edges);
    }
    std::vector<double> share(start.size(), 1.0);
    for (std::size_t v = 0; v < start.size(); ++v)
        if (refused[v]) share[v] = 0;
    shorten(near, apart, start, end, share);
    std::int64_t held = 0;
    for (std::size_t v = 0; v < start.size(); ++v)
        if (share[v] < 1) {
            end[v] = start[v] + share[v] * (end[v] - start[v]);
            ++held;
        }
    for (std::size_t v = 0; v < start.size(); ++v) {
        if (!active[v] && !refused[v]) continue;
        center_[v] = end[v];
        radius_[v] = refused[v] ? 0 : share_of_room * reach * near_[v];
    }
    for (std::size_t i = 0; i < near.size(); ++i) {
        const auto& v = near[i].v;
        Four place{}, step{};
        for (int k = 0; k < 4; ++k) place[k] = end[v[k]], step[k] = end[v[k]] - start[v[k]];
        const double most = approach(step, near[i].edges);
        const bool alike = most < as_good_as_still * apart[i];
        const double room = share_of_room * (alike ? apart[i] - most : distance(place, near[i].edges));
        for (std::int32_t w : v) {
            const double off = norm(end[w] - center_[w]);
            if (radius_[w] + off <= room) continue;
            radius_[w] = std::min(room, std::max(0.0, radius_[w] - off));  // within the old one
            center_[w] = end[w];
        }
    }
    return held;
}

}  // namespace deltamic_remesh
