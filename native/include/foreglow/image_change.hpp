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
    double strongest = 0.0;  // change of the mean that one block of 1,000 exceeds, but for the outer eighths of the rows
    std::int64_t num_samples = 0, num_changed = 0;    // pixels compared one by one, and those that are not as before
    std::int64_t num_bright = 0;  // samples that were bright three references ago
    // Share of the samples that do not change at all, as estimated from those that changed now, before and both times;
    // of all samples and of the bright ones, the lesser.
    double share_stuck = 0.0;
    // Samples that differ from the pixel beside them: there is noise, or an edge. Of these, the share that does not
    // change at all, as estimated in the same way, and the share that has not changed for 36 images.
    std::int64_t num_textured = 0;
    double share_stuck_texture = 0.0, share_same_long = 0.0;
    // Share of the samples that are as before and of the level that most bright ones of them have, if nearly all bright
    // ones of that level are as before; of all samples and of the bright ones, the lesser.
    double share_filled = 0.0;
    double contrast = 0.0;  // the mean of the bright samples less that of the others, of those not as before
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
// pairs of rows about 160 columns. Where no sample has changed, the image came twice, and the one before stays the one
// that says what had changed before.
class ImageComparer {
public:
    // Returns whether there was an image before, of the same size and type; only then `change` is written.
    // `top` is the greatest value that a pixel may have.
    bool compare(const ImageView& image, std::int32_t top, ImageChange& change);

    // Makes the latest image a reference: its bright samples are those above their mean. It counts after two others, so
    // that a part that turned dark of late was bright.
    void keep();

    // Forgets the image before, and the references.
    void reset();

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

    void forget_samples();
    void compare_samples(std::int32_t top, ImageChange& change);
    double share_filled(std::int32_t top, std::int64_t num_bright) const;

    Digest before_, now_;
    std::vector<std::uint32_t> changes_;
    // Of the samples; the references from the earliest on, as far as there are so many.
    std::array<std::vector<std::uint16_t>, 3> are_bright_;
    std::vector<std::uint16_t> is_textured_, is_changed_, was_changed_, num_same_;
};

}  // namespace foreglow
