// Boxes around vertices, edges and faces, and a grid that finds those that overlap.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "vec.h"

namespace deltamic_remesh {

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

// Cells of a regular grid; each holds the boxes that reach into it. Two sets of boxes; only cells
// that an active box reaches into are filled.
class BoxGrid {
public:
    BoxGrid(const std::vector<Box>& one, const std::vector<Box>& other, const std::vector<char>& active_one,
            const std::vector<char>& active_other)
        : one_(one), other_(other), active_one_(active_one), active_other_(active_other), same_(&one == &other) {
        lay_out();
        fill(one_, first_);
        if (!same_) fill(other_, second_);
    }

    // f(i, j) for each box i of one and j of the other that overlap, at least one of them active;
    // within one set each couple once.
    template <class F>
    void overlaps(F&& f) const {
        const Cells& b = same_ ? first_ : second_;
        for (std::size_t cell = 0; cell + 1 < first_.begin.size(); ++cell)
            for (std::int32_t k = first_.begin[cell]; k < first_.begin[cell + 1]; ++k) {
                const std::int32_t i = first_.item[k];
                const Box p = one_[i];
                const bool active = active_one_[i];
                for (std::int32_t l = same_ ? k + 1 : b.begin[cell]; l < b.begin[cell + 1]; ++l) {
                    const std::int32_t j = b.item[l];
                    if (!(active || active_other_[j])) continue;
                    const Box& q = other_[j];
                    if (p.meets(q) && home(p, q) == cell) f(i, j);
                }
            }
    }

private:
    struct Cells {
        std::vector<std::int32_t> begin, item;
    };
    const std::vector<Box>&one_, &other_;
    const std::vector<char>&active_one_, &active_other_;
    bool same_;
    std::array<double, 3> corner_{};
    std::array<std::int64_t, 3> shape_{1, 1, 1};
    double per_cell_ = 1;
    Cells first_, second_;

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

    void lay_out() {
        Box all{{0, 0, 0}, {0, 0, 0}};
        double side = 0;
        std::size_t count = 0;
        for (const auto* set : {&one_, &other_}) {
            const auto& active = set == &one_ ? active_one_ : active_other_;
            for (std::size_t i = 0; i < set->size(); ++i) {
                if (!active[i]) continue;
                const Box& b = (*set)[i];
                count ? all.take(b) : void(all = b);
                ++count;
                side += (b.high[0] - b.low[0] + b.high[1] - b.low[1] + b.high[2] - b.low[2]) / 3;
            }
        }
        if (!count) return;
        side = std::max(side / static_cast<double>(count), 1e-300);
        corner_ = all.low;
        for (;;) {  // no more cells than a few for each box
            double cells = 1;
            for (int k = 0; k < 3; ++k) cells *= std::floor((all.high[k] - all.low[k]) / side) + 1;
            if (cells <= 64.0 * static_cast<double>(count) + 4096) break;
            side *= 1.3;
        }
        for (int k = 0; k < 3; ++k) shape_[k] = static_cast<std::int64_t>((all.high[k] - all.low[k]) / side) + 1;
        per_cell_ = 1 / side;
        all_ = all;
        busy_.assign(static_cast<std::size_t>(shape_[0] * shape_[1] * shape_[2]), 0);
        for (const auto* set : {&one_, &other_}) {
            const auto& active = set == &one_ ? active_one_ : active_other_;
            for (std::size_t i = 0; i < set->size(); ++i)
                if (active[i]) for_cells((*set)[i], [&](std::size_t cell) { busy_[cell] = 1; });
            if (same_) break;
        }
    }

    void fill(const std::vector<Box>& boxes, Cells& cells) {
        cells.begin.assign(busy_.size() + 1, 0);
        if (busy_.empty()) return;
        std::vector<std::int32_t> entry, item;
        entry.reserve(8 * boxes.size());
        item.reserve(8 * boxes.size());
        for (std::size_t i = 0; i < boxes.size(); ++i) {
            if (!boxes[i].meets(all_)) continue;
            for_cells(boxes[i], [&](std::size_t cell) {
                if (!busy_[cell]) return;
                entry.push_back(static_cast<std::int32_t>(cell));
                item.push_back(static_cast<std::int32_t>(i));
                ++cells.begin[cell + 1];
            });
        }
        for (std::size_t c = 0; c + 1 < cells.begin.size(); ++c) cells.begin[c + 1] += cells.begin[c];
        cells.item.resize(item.size());
        std::vector<std::int32_t> next(cells.begin.begin(), cells.begin.end() - 1);
        for (std::size_t k = 0; k < item.size(); ++k) cells.item[next[entry[k]]++] = item[k];
    }
    Box all_{{0, 0, 0}, {0, 0, 0}};
    std::vector<char> busy_;
};

}  // namespace deltamic_remesh
