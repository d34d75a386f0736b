// What differs between an image and the one before, counted on means and lines of the images.
// The specification is in Python: tests/beam/image_change_reference.py.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "foreglow/image.hpp"

namespace foreglow {

// Tiles across and down for which the share of changed samples is told apart.
constexpr std::int64_t num_change_tiles = 8;

// Changes are in grey levels, of which the greatest value of a pixel has 255.
struct ImageChange {
    double strongest = 0.0;  // change of the mean that one block of 1,000 exceeds
    std::int64_t num_samples = 0, num_changed = 0;    // pixels compared one by one, and those that are not as before
    std::int64_t num_edges = 0, num_other_edges = 0;  // on the grid of encoders, and on one shifted by half a square
    std::int64_t num_rows = 0, num_repeated_rows = 0;  // rows looked at, and those that repeat
    // Of each tile, row by row, the share of its samples that are not as before; 1 where a tile has none.
    std::array<double, num_change_tiles * num_change_tiles> tiles{};
    double share_flat_rows = 0.0, share_flat_pieces = 0.0;  // of one value; pieces are eighths of a row
    // How much the rows of pairs differ over how much neighbouring pairs do, plus 1 each: by absolute and by squared
    // differences; of pairs that begin with an even and with an odd row.
    std::array<double, 4> pair_ratios{};
};

// Compares each image with the one before, of which it keeps a digest of 1 / 16 of its pixels. One object a thread.
//
// Blocks have 8 x 8 pixels; what is left over at the right and at the bottom is ignored, and an image that is smaller
// than a block is one. From each block one pixel is compared, too. An edge is a segment of 16 pixels between two
// squares of 16 x 16, across which the change differs by more than 10 grey levels in the mean. A row repeats if it is
// the same as the one below. For that and for being flat, every seventh row is looked at, the fourth one first, and in
// pairs of rows about 160 columns.
class ImageComparer {
public:
    // Returns whether there was an image before, of the same size and type; only then `change` is written.
    // `top` is the greatest value that a pixel may have.
    bool compare(const ImageView& image, std::int32_t top, ImageChange& change);

    // Forgets the image before.
    void reset() { now_ = Digest(); }

private:
    struct Digest {
        std::int32_t width_px = 0, height_px = 0;
        PixelType pixel_type = PixelType::u8;
        std::vector<std::uint32_t> blocks;  // sums of pixels
        std::vector<std::uint16_t> samples;
        // Sum behind a line less the sum before it: [segment][line], of the vertical and of the horizontal lines.
        // Lines are 8 pixels apart; every other one, beginning with the second, is on the grid of encoders.
        std::vector<std::int32_t> vertical, horizontal;
    };

    template <typename Pixel>
    void digest(const ImageView& image, ImageChange& change);

    Digest before_, now_;
    std::vector<std::uint32_t> changes_;
};

}  // namespace foreglow
