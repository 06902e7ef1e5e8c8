// Boxes around vertices, edges and faces, and a grid that finds those that overlap.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "vec.h"

namespace deltamic_remesh {

using Two = std::array<std::int32_t, 2>;

struct Box {
    std::array<double, 3> low, high;

    static Box around(Vec a) { return {{a.z, a.y, a.x}, {a.z, a.y, a.x}}; }
    void take(const Box& b) {
        for (int k = 0; k < 3; ++k) {
            low[k] = std::min(low[k], b.low[k]);
            high[k] = std::max(high[k], b.high[k]);
        }
    }
    void grow(double by) {
        for (int k = 0; k < 3; ++k) low[k] -= by, high[k] += by;
    }
    bool meets(const Box& b) const {
        return low[0] <= b.high[0] && b.low[0] <= high[0] && low[1] <= b.high[1] && b.low[1] <= high[1] &&
               low[2] <= b.high[2] && b.low[2] <= high[2];
    }
};

// Cells of a regular grid; each holds the boxes that reach into it. Two sets of boxes, or one and
// itself; only cells that an active box reaches into are filled. The work is at most proportional
// to the number of boxes, however they lie.
class BoxGrid {
public:
    // finer: divides the side of the cells.
    BoxGrid(const std::vector<Box>& one, const std::vector<Box>& other, const std::vector<char>& active_one,
            const std::vector<char>& active_other, double finer = 1)
        : same_(&one == &other) {
        first_.box = &one;
        first_.active = &active_one;
        second_.box = &other;
        second_.active = &active_other;
        lay_out(finer);
        if (busy_.empty()) return;
        fill(first_);
        if (!same_) fill(second_);
    }

    // f(i, j) for each box i of one and j of the other that overlap, at least one of them active;
    // within one set each couple once; those for which related(i, j) are left out. Cells with more
    // than `most` boxes are passed over:
    // crowded(i, j) for the boxes in them, -1 where there is none.
    template <class R, class F, class G>
    void overlaps(R&& related, F&& f, std::size_t most, G&& crowded) {
        if (busy_.empty()) return;
        const Set& b = same_ ? first_ : second_;
        for (std::size_t cell = 0; cell < busy_.size(); ++cell) {
            if (!busy_[cell]) continue;
            const std::size_t m = first_.gather(cell, corner_, slack_, side_of_first_);
            const std::size_t n = same_ ? m : second_.gather(cell, corner_, slack_, side_of_second_);
            if (m + n > most) {
                for (std::size_t k = 0; k < m; ++k) crowded(first_.in(cell, k), -1);
                for (std::size_t l = 0; l < n && !same_; ++l) crowded(-1, second_.in(cell, l));
                continue;
            }
            const Sides& with = same_ ? side_of_first_ : side_of_second_;
            const std::size_t active_first = first_.actives(cell);
            for (std::size_t k = 0; k < (same_ ? active_first : m); ++k) {  // the active ones come first
                const std::size_t from = same_ ? k + 1 : 0, to = k < active_first ? n : b.actives(cell);
                tests += to - from;
                with.meet(side_of_first_, k, from, to, hit_);
                for (std::size_t l = from; l < to; ++l) {
                    if (!hit_[l]) continue;
                    const std::int32_t i = first_.in(cell, k), j = b.in(cell, l);
                    if (!related(i, j) && home((*first_.box)[i], (*b.box)[j]) == cell) f(i, j);
                }
            }
        }
    }
    template <class R, class F>
    void overlaps(R&& related, F&& f) {
        overlaps(related, f, static_cast<std::size_t>(-1), [](std::int32_t, std::int32_t) {});
    }

    std::size_t tests = 0;  // couples of boxes looked at

private:
    // Those in a cell, a little larger, in single precision: many are looked at together.
    struct Sides {
        std::array<std::vector<float>, 3> low, high;

        void meet(const Sides& other, std::size_t k, std::size_t from, std::size_t to,
                  std::vector<std::int32_t>& hit) const {
            if (hit.size() < to) hit.resize(to);
            const float a = other.low[0][k], b = other.low[1][k], c = other.low[2][k];
            const float d = other.high[0][k], e = other.high[1][k], g = other.high[2][k];
            const float *p = low[0].data(), *q = low[1].data(), *r = low[2].data();
            const float *s = high[0].data(), *t = high[1].data(), *u = high[2].data();
            std::int32_t* out = hit.data();
            for (std::size_t l = from; l < to; ++l)
                out[l] = (p[l] <= d) & (q[l] <= e) & (r[l] <= g) & (s[l] >= a) & (t[l] >= b) & (u[l] >= c);
        }
    };
    struct Set {
        const std::vector<Box>* box;
        const std::vector<char>* active;
        std::vector<std::int32_t> begin, middle, item;  // of a cell: active ones, from the middle on others

        std::int32_t in(std::size_t cell, std::size_t k) const { return item[begin[cell] + k]; }
        std::size_t actives(std::size_t cell) const { return static_cast<std::size_t>(middle[cell] - begin[cell]); }
        std::size_t gather(std::size_t cell, const std::array<double, 3>& corner, double slack, Sides& sides) const {
            const auto n = static_cast<std::size_t>(begin[cell + 1] - begin[cell]);
            for (int d = 0; d < 3; ++d) {
                if (sides.low[d].size() < n) sides.low[d].resize(2 * n), sides.high[d].resize(2 * n);
                for (std::size_t k = 0; k < n; ++k) {
                    const Box& b = (*box)[in(cell, k)];
                    sides.low[d][k] = static_cast<float>(b.low[d] - corner[d] - slack);
                    sides.high[d][k] = static_cast<float>(b.high[d] - corner[d] + slack);
                }
            }
            return n;
        }
    };
    static constexpr double wide = 2.5;  // side of a cell, in sides of the boxes

    bool same_;
    Box all_{{0, 0, 0}, {0, 0, 0}};
    std::array<double, 3> corner_{};
    std::array<std::int64_t, 3> shape_{1, 1, 1};
    double per_cell_ = 1, slack_ = 0;
    Set first_, second_;
    Sides side_of_first_, side_of_second_;
    std::vector<std::int32_t> hit_;
    std::vector<char> busy_;

    std::int64_t at(double place, int axis) const {
        const auto k = static_cast<std::int64_t>((place - corner_[axis]) * per_cell_);
        return std::clamp<std::int64_t>(k, 0, shape_[axis] - 1);
    }
    // Of a couple that shares several cells, the one that counts.
    std::size_t home(const Box& p, const Box& q) const {
        std::array<std::int64_t, 3> c{};
        for (int k = 0; k < 3; ++k) c[k] = at(std::max(p.low[k], q.low[k]), k);
        return static_cast<std::size_t>((c[0] * shape_[1] + c[1]) * shape_[2] + c[2]);
    }
    template <class F>
    void for_cells(const Box& b, F&& f) const {
        std::array<std::int64_t, 3> from{}, to{};
        for (int k = 0; k < 3; ++k) from[k] = at(b.low[k], k), to[k] = at(b.high[k], k);
        for (std::int64_t z = from[0]; z <= to[0]; ++z)
            for (std::int64_t y = from[1]; y <= to[1]; ++y)
                for (std::int64_t x = from[2]; x <= to[2]; ++x)
                    f(static_cast<std::size_t>((z * shape_[1] + y) * shape_[2] + x));
    }

    template <class F>
    void for_active(F&& f) const {
        for (const Set* set : {&first_, &second_}) {
            for (std::size_t i = 0; i < set->box->size(); ++i)
                if ((*set->active)[i]) f((*set->box)[i]);
            if (same_) break;
        }
    }

    void lay_out(double finer) {
        double side = 0, count = 0;
        for_active([&](const Box& b) {
            count > 0 ? all_.take(b) : void(all_ = b);
            count += 1;
            side += (b.high[0] - b.low[0] + b.high[1] - b.low[1] + b.high[2] - b.low[2]) / 3;
        });
        if (count == 0) return;
        corner_ = all_.low;
        double extent = 0;
        for (int k = 0; k < 3; ++k) extent = std::max(extent, all_.high[k] - all_.low[k]);
        slack_ = 1e-6 * extent;  // single precision rounds by less
        side = std::max({wide * side / count / finer, 1e-9 * extent, 1e-300});
        const auto along = [&](double length) { return std::floor(length / side) + 1; };
        for (;; side *= 1.3) {  // no more cells than a few for each box, and no more boxes in them
            double cells = 1, places = 0;
            for (int k = 0; k < 3; ++k) cells *= along(all_.high[k] - all_.low[k]);
            if (cells > 64 * count + 4096) continue;
            for_active([&](const Box& b) {
                places += along(b.high[0] - b.low[0]) * along(b.high[1] - b.low[1]) * along(b.high[2] - b.low[2]);
            });
            if (places <= 16 * count + 4096) break;
        }
        for (int k = 0; k < 3; ++k) shape_[k] = static_cast<std::int64_t>(along(all_.high[k] - all_.low[k]));
        per_cell_ = 1 / side;
        busy_.assign(static_cast<std::size_t>(shape_[0] * shape_[1] * shape_[2]), 0);
        for_active([&](const Box& b) { for_cells(b, [&](std::size_t cell) { busy_[cell] = 1; }); });
    }

    void fill(Set& set) const {
        const std::size_t n = set.box->size();
        set.begin.assign(busy_.size() + 1, 0);
        set.middle.assign(busy_.size(), 0);
        std::vector<Two> places;  // cell, box
        places.reserve(4 * n);
        for (std::size_t i = 0; i < n; ++i) {
            const bool active = (*set.active)[i];
            if (!active && !(*set.box)[i].meets(all_)) continue;
            for_cells((*set.box)[i], [&](std::size_t cell) {
                if (!busy_[cell]) return;
                places.push_back({static_cast<std::int32_t>(cell), static_cast<std::int32_t>(i)});
                ++set.begin[cell + 1];
                set.middle[cell] += active;
            });
        }
        for (std::size_t c = 0; c < busy_.size(); ++c) {
            set.begin[c + 1] += set.begin[c];
            set.middle[c] += set.begin[c];
        }
        set.item.resize(static_cast<std::size_t>(set.begin.back()));
        std::vector<std::int32_t> next(set.begin.begin(), set.begin.end() - 1), after = set.middle;
        for (const auto& [cell, i] : places) set.item[((*set.active)[i] ? next : after)[cell]++] = i;
    }
};

}  // namespace deltamic_remesh
