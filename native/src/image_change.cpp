#include "foreglow/image_change.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <numeric>
#include <type_traits>

namespace foreglow {
namespace {

constexpr std::int32_t block_px = 8, square_px = 2 * block_px;
constexpr std::int32_t top_level = 255;   // the greatest value has so many 8-bit grey levels
constexpr std::int32_t edge_levels = 10;  // 8-bit grey levels, in the mean along the edge
constexpr std::int64_t row_step = 7;      // one row of so many is looked at: a prime number, for every pattern of rows
constexpr std::int64_t rare = 1000;       // one block of so many changes more than the strongest change
constexpr std::int64_t max_pieces = 8;    // of a row, to see whether one is flat
constexpr std::int64_t num_columns = 160; // about so many are compared from row to row

struct Grid {
    std::int64_t block_height, block_width, num_down, num_across;  // blocks
    std::int64_t segments_down, segments_across;                   // segments of a vertical line, of a horizontal one
    std::int64_t lines_down, lines_across;                         // horizontal lines, vertical ones

    explicit Grid(const ImageView& image)
        : block_height(std::min<std::int64_t>(block_px, image.height_px)),
          block_width(std::min<std::int64_t>(block_px, image.width_px)),
          num_down(image.height_px / block_height),
          num_across(image.width_px / block_width),
          segments_down(image.height_px / square_px),
          segments_across(image.width_px / square_px),
          lines_down((image.height_px - 1) / block_px),
          lines_across((image.width_px - 1) / block_px) {}
};

// Eight rows at once where there are so many, so that each sum is written once.
template <typename Pixel, typename Sum>
void sum_columns(const ImageView& image, std::int64_t first_row, std::int64_t num_rows, Sum* sums) {
    const std::int64_t width = image.width_px;
    if (num_rows == block_px) {
        const Pixel* rows[block_px];
        for (std::int64_t i = 0; i < block_px; ++i) rows[i] = image.row<Pixel>(first_row + i);
        const Pixel *a = rows[0], *b = rows[1], *c = rows[2], *d = rows[3], *e = rows[4], *f = rows[5], *g = rows[6],
                    *h = rows[7];
        for (std::int64_t x = 0; x < width; ++x) {
            sums[x] = static_cast<Sum>(a[x] + b[x] + c[x] + d[x] + e[x] + f[x] + g[x] + h[x]);
        }
        return;
    }
    std::fill(sums, sums + width, Sum{0});
    for (std::int64_t i = 0; i < num_rows; ++i) {
        const Pixel* row = image.row<Pixel>(first_row + i);
        for (std::int64_t x = 0; x < width; ++x) sums[x] = static_cast<Sum>(sums[x] + row[x]);
    }
}

template <typename Pixel>
bool is_flat(const Pixel* row, std::int64_t first, std::int64_t end) {
    return std::all_of(row + first, row + end, [value = row[first]](Pixel pixel) { return pixel == value; });
}

// What the rows of one image are like; takes them one by one.
template <typename Pixel>
class Rows {
public:
    explicit Rows(const ImageView& image)
        : image_(image),
          every_(std::max<std::int64_t>(1, image.width_px / num_columns)),
          above_(static_cast<std::size_t>((image.width_px + every_ - 1) / every_)),
          here_(above_.size()) {}

    void take(std::int64_t y) {
        if (y % row_step == row_step / 2) {  // in the middle, so that a share of the rows is that of the image
            if (y + 1 < image_.height_px) find_repetition(y);
            find_flat_pieces(y);
        }
        compare_with_above(y);
    }

    void write(ImageChange& change) const {
        change.num_rows = num_rows_;
        change.num_repeated_rows = num_repeated_;
        if (num_pieces_ > 0) {
            change.share_flat_rows = static_cast<double>(num_flat_rows_) / static_cast<double>(num_middle_);
            change.share_flat_pieces = static_cast<double>(num_flat_pieces_) / static_cast<double>(num_pieces_);
        }
        change.pair_ratios = {steps_[0] / steps_[1], steps_[1] / steps_[0], squares_[0] / squares_[1],
                              squares_[1] / squares_[0]};
    }

private:
    // The narrowest types that hold a difference, and the sum of a row's squares: so more of them fit into a register.
    using Step = std::conditional_t<sizeof(Pixel) == 1, std::int16_t, std::int64_t>;
    using Sum = std::conditional_t<sizeof(Pixel) == 1, std::int32_t, std::int64_t>;

    void find_repetition(std::int64_t y) {
        const auto num_bytes = static_cast<std::size_t>(image_.width_px) * sizeof(Pixel);
        ++num_rows_;
        num_repeated_ += std::memcmp(image_.row<Pixel>(y), image_.row<Pixel>(y + 1), num_bytes) == 0;
    }

    void find_flat_pieces(std::int64_t y) {
        const Pixel* row = image_.row<Pixel>(y);
        const std::int64_t width = image_.width_px, num = width < max_pieces ? 1 : max_pieces;
        ++num_middle_;
        num_pieces_ += num;
        num_flat_rows_ += is_flat(row, 0, width);
        for (std::int64_t i = 0; i < num; ++i) {
            num_flat_pieces_ += is_flat(row, i * width / num, (i + 1) * width / num);
        }
    }

    void compare_with_above(std::int64_t y) {
        const Pixel* pixels = image_.row<Pixel>(y);
        std::swap(above_, here_);
        for (std::size_t i = 0; i < here_.size(); ++i) here_[i] = pixels[static_cast<std::int64_t>(i) * every_];
        if (y == 0) return;
        Sum sum = 0, sum_of_squares = 0;
        for (std::size_t i = 0; i < here_.size(); ++i) {
            const auto step = static_cast<Step>(here_[i] - above_[i]);
            sum += std::abs(step);
            sum_of_squares += Sum{step} * step;
        }
        steps_[(y + 1) % 2] += static_cast<double>(sum);
        squares_[(y + 1) % 2] += static_cast<double>(sum_of_squares);
    }

    const ImageView& image_;
    std::int64_t every_;
    std::vector<Step> above_, here_;
    std::int64_t num_rows_ = 0, num_repeated_ = 0;  // looked at for repetition
    std::int64_t num_middle_ = 0, num_flat_rows_ = 0, num_pieces_ = 0, num_flat_pieces_ = 0;
    double steps_[2] = {1.0, 1.0}, squares_[2] = {1.0, 1.0};  // within pairs of rows and between them
};

// Sums over the segments of a horizontal line, behind it less before it.
template <typename Pixel>
void sum_jumps(const ImageView& image, const Grid& grid, std::int64_t line, std::int32_t* horizontal) {
    const Pixel* behind = image.row<Pixel>((line + 1) * block_px);
    const Pixel* before = image.row<Pixel>((line + 1) * block_px - 1);
    for (std::int64_t i = 0; i < grid.segments_across; ++i) {
        std::int32_t jump = 0;
        for (std::int64_t k = 0; k < square_px; ++k) jump += behind[i * square_px + k] - before[i * square_px + k];
        horizontal[i * grid.lines_down + line] = jump;
    }
}

// Counts where the two differ by more than `limit`, at every other place on its own: counts[0] and counts[1].
void count_edges(const std::int32_t* now, const std::int32_t* before, std::int64_t num, std::int32_t limit,
                 std::int64_t* counts) {
    std::int32_t found[2] = {0, 0};
    std::int64_t i = 0;
    for (; i + 1 < num; i += 2) {
        found[0] += std::abs(now[i] - before[i]) > limit;
        found[1] += std::abs(now[i + 1] - before[i + 1]) > limit;
    }
    if (i < num) found[0] += std::abs(now[i] - before[i]) > limit;
    counts[0] += found[0];
    counts[1] += found[1];
}

}  // namespace

template <typename Pixel>
void ImageComparer::digest(const ImageView& image, ImageChange& change) {
    const Grid grid(image);
    now_.width_px = image.width_px;
    now_.height_px = image.height_px;
    now_.pixel_type = image.pixel_type;
    now_.blocks.resize(static_cast<std::size_t>(grid.num_down * grid.num_across));
    now_.samples.resize(now_.blocks.size());
    now_.vertical.assign(static_cast<std::size_t>(grid.lines_across * grid.segments_down), 0);
    now_.horizontal.resize(static_cast<std::size_t>(grid.lines_down * grid.segments_across));
    Rows<Pixel> rows(image);
    using Sum = std::conditional_t<sizeof(Pixel) == 1, std::uint16_t, std::uint32_t>;
    std::vector<Sum> column_sums(static_cast<std::size_t>(image.width_px));
    const Sum* sums = column_sums.data();
    // All that is counted on a band of rows is counted while they are in the nearest cache.
    for (std::int64_t top = 0, j = 0; top < image.height_px; top += block_px, ++j) {
        if (j > 0) sum_jumps<Pixel>(image, grid, j - 1, now_.horizontal.data());
        const std::int64_t bottom = std::min<std::int64_t>(top + block_px, image.height_px);
        for (std::int64_t y = top; y < bottom; ++y) rows.take(y);
        if (j == grid.num_down) break;
        sum_columns<Pixel, Sum>(image, top, grid.block_height, column_sums.data());
        const Pixel* middle = image.row<Pixel>(top + grid.block_height / 2);
        for (std::int64_t i = 0; i < grid.num_across; ++i) {
            const Sum* block = sums + i * grid.block_width;
            const auto index = static_cast<std::size_t>(j * grid.num_across + i);
            now_.blocks[index] = std::accumulate(block, block + grid.block_width, 0U);
            now_.samples[index] = middle[i * grid.block_width + grid.block_width / 2];
        }
        if (j / 2 >= grid.segments_down) continue;
        std::int32_t* jumps = now_.vertical.data() + j / 2 * grid.lines_across;
        for (std::int64_t i = 0; i < grid.lines_across; ++i) {
            const Sum* behind = sums + (i + 1) * block_px;
            jumps[i] += static_cast<std::int32_t>(behind[0]) - static_cast<std::int32_t>(behind[-1]);
        }
    }
    rows.write(change);
}

bool ImageComparer::compare(const ImageView& image, std::int32_t top, ImageChange& change) {
    const bool is_u8 = image.pixel_type == PixelType::u8;
    std::swap(before_, now_);
    ImageChange found;
    is_u8 ? digest<std::uint8_t>(image, found) : digest<std::uint16_t>(image, found);
    if (before_.width_px != now_.width_px || before_.height_px != now_.height_px ||
        before_.pixel_type != now_.pixel_type) {
        return false;
    }
    const Grid grid(image);
    const auto block_area = static_cast<double>(grid.block_height * grid.block_width);
    const double mean_levels = top_level / (static_cast<double>(top) * block_area);
    change = found;
    changes_.resize(now_.blocks.size());
    for (std::size_t i = 0; i < changes_.size(); ++i) {
        changes_[i] = std::max(now_.blocks[i], before_.blocks[i]) - std::min(now_.blocks[i], before_.blocks[i]);
    }
    change.num_samples = static_cast<std::int64_t>(changes_.size());
    const auto first = [](std::int64_t tile, std::int64_t num) {
        return static_cast<std::size_t>((tile * num + num_change_tiles - 1) / num_change_tiles);
    };
    for (std::int64_t tile = 0; tile < num_change_tiles * num_change_tiles; ++tile) {
        const std::int64_t down = tile / num_change_tiles, across = tile % num_change_tiles;
        const std::size_t left = first(across, grid.num_across), right = first(across + 1, grid.num_across);
        std::int64_t num_changed = 0, num_samples = 0;
        for (std::size_t j = first(down, grid.num_down); j < first(down + 1, grid.num_down); ++j) {
            const std::uint16_t* now = now_.samples.data() + j * static_cast<std::size_t>(grid.num_across);
            const std::uint16_t* before = before_.samples.data() + j * static_cast<std::size_t>(grid.num_across);
            for (std::size_t i = left; i < right; ++i) num_changed += now[i] != before[i];
            num_samples += static_cast<std::int64_t>(right - left);
        }
        change.num_changed += num_changed;
        change.tiles[static_cast<std::size_t>(tile)] =
            num_samples ? static_cast<double>(num_changed) / static_cast<double>(num_samples) : 1.0;
    }
    std::vector<std::uint32_t> strongest(changes_.size() / rare + 1);
    std::partial_sort_copy(changes_.begin(), changes_.end(), strongest.begin(), strongest.end(), std::greater<>());
    change.strongest = strongest.back() * mean_levels;
    const std::int32_t limit = edge_levels * square_px * top / top_level;
    std::int64_t counts[2] = {0, 0};  // the first line of either direction is half a square off the grid
    for (std::int64_t j = 0; j < grid.segments_down; ++j) {
        const std::int64_t first = j * grid.lines_across;
        count_edges(now_.vertical.data() + first, before_.vertical.data() + first, grid.lines_across, limit, counts);
    }
    for (std::int64_t i = 0; i < grid.segments_across; ++i) {
        const std::int64_t first = i * grid.lines_down;
        count_edges(now_.horizontal.data() + first, before_.horizontal.data() + first, grid.lines_down, limit, counts);
    }
    change.num_other_edges = counts[0];
    change.num_edges = counts[1];
    return true;
}

}  // namespace foreglow
