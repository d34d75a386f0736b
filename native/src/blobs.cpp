#include "blobs.hpp"

#include <algorithm>

#include "bits.hpp"

namespace foreglow {
void BlobFinder::start(std::int32_t gap_px) {
    gap_px_ = gap_px;
    y_ = 0;
    rows_.resize(static_cast<std::size_t>(gap_px) + 1);
    for (auto& row : rows_) row.clear();
    parents_.clear();
    extents_.clear();
}

std::int32_t BlobFinder::root(std::int32_t blob) {
    while (parents_[blob] != blob) {
        parents_[blob] = parents_[parents_[blob]];
        blob = parents_[blob];
    }
    return blob;
}

void BlobFinder::join(std::int32_t a, std::int32_t b) {
    a = root(a);
    b = root(b);
    if (a == b) return;
    if (b < a) std::swap(a, b);
    parents_[b] = a;
    Box& box = extents_[a];
    const Box& other = extents_[b];
    box = {std::min(box.x1, other.x1), std::min(box.y1, other.y1), std::max(box.x2, other.x2),
           std::max(box.y2, other.y2)};
}

void BlobFinder::add_bits(std::uint64_t bits, std::int32_t column) {
    while (bits != 0) {
        const int start = __builtin_ctzll(bits);
        const std::uint64_t shifted = ~(bits >> start);
        const int length = shifted == 0 ? 64 - start : std::min(__builtin_ctzll(shifted), 64 - start);
        const std::int32_t first = column + start, last = first + length - 1;
        if (!current_->empty() && first - current_->back().last <= gap_px_) {
            current_->back().last = last;
        } else {
            current_->push_back({first, last, -1});
        }
        bits = start + length >= 64 ? 0 : bits & (~0ULL << (start + length));
    }
}

void BlobFinder::link(std::vector<Run>& row, const std::vector<Run>& earlier) {
    std::size_t from = 0;
    for (const Run& run : row) {
        while (from < earlier.size() && earlier[from].last < run.first - gap_px_) ++from;
        for (std::size_t i = from; i < earlier.size() && earlier[i].first <= run.last + gap_px_; ++i) {
            join(run.blob, earlier[i].blob);
        }
    }
}

void BlobFinder::add_row(const std::uint64_t* even, const std::uint64_t* odd, std::int64_t num_words) {
    const auto num_rows = static_cast<std::int32_t>(rows_.size());
    current_ = &rows_[y_ % num_rows];
    current_->clear();
    for (std::int64_t word = 0; word < num_words; ++word) {
        if ((even[word] | odd[word]) == 0) continue;
        const auto column = static_cast<std::int32_t>(word * 128);
        add_bits(interleaved(even[word], odd[word]), column);
        add_bits(interleaved(even[word] >> 32, odd[word] >> 32), column + 64);
    }
    for (Run& run : *current_) {
        run.blob = static_cast<std::int32_t>(parents_.size());
        parents_.push_back(run.blob);
        extents_.push_back({run.first, y_, run.last + 1, y_ + 1});
    }
    if (!current_->empty()) {
        for (std::int32_t back = 1; back <= std::min(gap_px_, y_); ++back) {
            link(*current_, rows_[(y_ - back) % num_rows]);
        }
    }
    ++y_;
}

const std::vector<Box>& BlobFinder::boxes() {
    boxes_.clear();
    for (std::size_t blob = 0; blob < parents_.size(); ++blob) {
        if (parents_[blob] == static_cast<std::int32_t>(blob)) boxes_.push_back(extents_[blob]);
    }
    return boxes_;
}

}  // namespace foreglow
