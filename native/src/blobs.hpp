// Blobs of a binary image whose rows are given as bits.
#pragma once

#include <cstdint>
#include <vector>

#include "foreglow/image.hpp"

namespace foreglow {

// Joins set pixels that are at most `gap_px` apart in the L-infinity sense, transitively, and keeps each blob's
// bounding box. Rows are added from top to bottom.
class BlobFinder {
public:
    void start(std::int32_t gap_px);

    // The next row: bit i of even[w] is column 2 (64 w + i), of odd[w] the column after it.
    void add_row(const std::uint64_t* even, const std::uint64_t* odd, std::int64_t num_words);

    // Bounding boxes of all blobs so far, half-open, in no particular order.
    const std::vector<Box>& boxes();

private:
    // Pixels of a row with gaps of at most gap_px - 1 between them; every column of first..last lies within gap_px / 2
    // of a set pixel, so linking runs of different rows by their ends links no pixels that are too far apart.
    struct Run {
        std::int32_t first, last, blob;
    };

    std::int32_t root(std::int32_t blob);
    void join(std::int32_t a, std::int32_t b);
    void add_bits(std::uint64_t bits, std::int32_t column);
    void link(std::vector<Run>& row, const std::vector<Run>& earlier);

    std::int32_t gap_px_ = 1;
    std::int32_t y_ = 0;
    std::vector<std::vector<Run>> rows_;  // the last gap_px + 1 rows, in a ring
    std::vector<Run>* current_ = nullptr;
    std::vector<std::int32_t> parents_;
    std::vector<Box> extents_;
    std::vector<Box> boxes_;
};

}  // namespace foreglow
