// Splits a blob whose light has several peaks with deep saddles between them, such as a lamp and its reflection.
#pragma once

#include <cstdint>
#include <vector>

#include "adaptive_threshold.hpp"
#include "foreglow/image.hpp"
#include "working_image.hpp"

namespace foreglow {

// When a blob is split; see `split_saddle` in foreglow.config.ProposalConfig and foreglow/proposals/splitting.py.
struct SplitRule {
    double saddle = 0.0;
    double min_area_px = 0.0, min_width_px = 0.0;
};

// Floods the set pixels of a box from the brightest down. A peak's pixels become a part of their own where they meet
// those of a higher peak at a level of at most `saddle` times their own peak; from then on neither part grows wider, and
// other peaks that they meet become parts of their own, too.
class BlobSplitter {
public:
    // Levels that the range of the frame is divided into, less one.
    static constexpr std::int64_t top_level = 1023;

    void start(std::int64_t width, std::int64_t height);
    void add_row(const BinaryRow& row);

    // Appends the parts of `box` to `parts`, or `box` itself where it is left whole. `black` is the sum that counts as
    // level 0, `range` the distance from it that counts as the highest.
    void split(const Box& box, const WorkingImage& image, std::int64_t black, std::int64_t range, const SplitRule& rule,
               std::vector<Box>& parts);

private:
    struct Part {
        std::int32_t parent, peak, num_pixels;
        Box extent;
        bool is_closed = false;
    };
    struct Pixel {
        std::int16_t level;
        std::int32_t x, y;  // in the box
    };

    static void widen(Part& part, const Box& box);
    template <typename Sum>
    void collect(const Box& box, const WorkingImage& image, std::int64_t black, std::int64_t range);
    void sort();
    void flood(std::int32_t width, std::int32_t height, const SplitRule& rule);
    std::int32_t root(std::int32_t part);

    std::int64_t num_words_ = 0, y_ = 0;
    std::vector<std::uint64_t> bits_;  // the binary image, 64 columns a word
    std::vector<Pixel> pixels_, sorted_;
    std::vector<std::int32_t> starts_;
    std::vector<std::int32_t> part_of_;  // the box with a border of one pixel; -1 where none is yet
    std::vector<Part> parts_;
};

}  // namespace foreglow
