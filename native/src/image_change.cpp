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
constexpr std::size_t num_at_once = 1 << 15;  // samples are counted at once, so that sums fit into their types
constexpr std::int64_t rarely_filled = 20;  // less than one bright sample of so many says nothing
constexpr double filled_share = 0.9;        // of the samples of one level, so many are as before where it is a filling
constexpr std::uint16_t long_images = 36;   // a sample that is as before in so many images has not changed for long
constexpr std::int64_t rare = 1000;  // one block of so many changes more than the strongest change
constexpr std::int64_t border_share = 8;  // of the rows, at the top and at the bottom, where a recorder writes the time
constexpr std::int64_t max_pieces = 8;    // of a row, to see whether one is flat
constexpr std::int64_t num_columns = 160; // about so many are compared from row to row

// How many samples there are of a kind, and of these not as before: now, in the image before, and both times. Of those
// now, the sum. The first type is narrow, so that more of them fit into a register.
template <typename Number>
struct SampleCount {
    Number num = 0, num_now = 0, num_before = 0, num_twice = 0;
    std::uint64_t sum = 0;

    template <typename Other>
    void add(const SampleCount<Other>& other) {
        num += other.num;
        num_now += other.num_now;
        num_before += other.num_before;
        num_twice += other.num_twice;
        sum += other.sum;
    }

    // Noise takes a share of the samples that are alive, each time another one. As many are in a lake as the catches of
    // two days are, multiplied, over the number caught twice (F. C. Lincoln, 1930); the others do not change at all.
    double share_stuck() const {
        const auto as_double = [](Number of) { return static_cast<double>(of); };
        return num_twice ? 1.0 - as_double(num_now) * as_double(num_before) / (as_double(num) * as_double(num_twice))
                         : 0.0;
    }
};

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

// Where in its block a sample lies: anywhere, as if by chance, so that no pattern of rows or columns is missed.
std::int64_t place_of_sample(std::size_t block, std::int64_t block_side, int shift) {
    const auto mixed = static_cast<std::uint32_t>(block) * 2654435761U;  // Knuth's multiplicative hashing
    return (mixed >> shift & 0xff) * block_side >> 8;
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
    is_textured_.resize(now_.blocks.size());
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
        for (std::int64_t i = 0; i < grid.num_across; ++i) {
            const Sum* block = sums + i * grid.block_width;
            const auto index = static_cast<std::size_t>(j * grid.num_across + i);
            now_.blocks[index] = std::accumulate(block, block + grid.block_width, 0U);
            const Pixel* row = image.row<Pixel>(top + place_of_sample(index, grid.block_height, 24));
            const std::int64_t x = i * grid.block_width + place_of_sample(index, grid.block_width, 16);
            now_.samples[index] = row[x];
            is_textured_[index] = row[x] != row[x + 1 < image.width_px ? x + 1 : std::max<std::int64_t>(0, x - 1)];
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

void ImageComparer::compare_samples(std::int32_t top, ImageChange& change) {
    const std::size_t num = now_.samples.size();
    are_bright_.front().resize(num, 1);
    was_changed_.resize(num, 1);
    is_changed_.resize(num);
    num_same_.resize(num);
    SampleCount<std::int64_t> all, bright, textured;
    std::int64_t num_same_long = 0;
    for (std::size_t first = 0; first < num; first += num_at_once) {
        const std::uint16_t *now = now_.samples.data() + first, *before = before_.samples.data() + first,
                            *is_bright = are_bright_.front().data() + first, *was_changed = was_changed_.data() + first;
        std::uint16_t* is_changed = is_changed_.data() + first;
        const std::size_t end = std::min(num_at_once, num - first);
        std::uint16_t num_now = 0, num_before = 0, num_twice = 0, bright_num = 0, bright_now = 0, bright_before = 0,
                      bright_twice = 0;
        std::uint32_t sum = 0, bright_sum = 0;
        for (std::size_t i = 0; i < end; ++i) {
            const std::uint16_t here = now[i] != before[i], twice = here & was_changed[i];
            is_changed[i] = here;
            num_now += here;
            num_before += was_changed[i];
            num_twice += twice;
            bright_num += is_bright[i];
            bright_now += is_bright[i] & here;
            bright_before += is_bright[i] & was_changed[i];
            bright_twice += is_bright[i] & twice;
            const std::uint16_t sample = here ? now[i] : 0, bright_sample = is_bright[i] ? sample : 0;
            sum += sample;
            bright_sum += bright_sample;
        }
        all.add(SampleCount<std::uint16_t>{static_cast<std::uint16_t>(end), num_now, num_before, num_twice, sum});
        bright.add(SampleCount<std::uint16_t>{bright_num, bright_now, bright_before, bright_twice, bright_sum});
    }
    change.num_changed = all.num_now;
    change.num_bright = bright.num;
    change.share_stuck = std::min(all.share_stuck(), bright.share_stuck());
    change.share_filled = share_filled(top, bright.num);
    const auto mean = [](std::uint64_t of, std::int64_t num_of) {
        return num_of ? static_cast<double>(of) / static_cast<double>(num_of) : 0.0;
    };
    change.contrast = (mean(bright.sum, bright.num_now) - mean(all.sum - bright.sum, all.num_now - bright.num_now)) *
                      top_level / static_cast<double>(top);
    if (all.num_now == 0) return;
    for (std::size_t i = 0; i < num; ++i) {
        const std::uint16_t same = is_changed_[i] ^ 1, was_changed = was_changed_[i] & is_textured_[i];
        num_same_[i] = same ? static_cast<std::uint16_t>(std::min<int>(num_same_[i] + 1, long_images)) : 0;
        num_same_long += is_textured_[i] & (num_same_[i] == long_images);
        textured.num += is_textured_[i];
        textured.num_now += is_textured_[i] & is_changed_[i];
        textured.num_before += was_changed;
        textured.num_twice += was_changed & is_changed_[i];
    }
    change.num_textured = textured.num;
    change.share_stuck_texture = textured.share_stuck();
    change.share_same_long = textured.num ? static_cast<double>(num_same_long) / static_cast<double>(textured.num) : 0.0;
    std::swap(is_changed_, was_changed_);
}

double ImageComparer::share_filled(std::int32_t top, std::int64_t num_bright) const {
    const std::vector<std::uint16_t>& is_bright = are_bright_.front();
    const std::size_t num = now_.samples.size();
    const auto level_of = [this, top](std::size_t i) {
        return std::min<std::int64_t>(now_.samples[i], top) * top_level / top;
    };
    std::array<std::int64_t, top_level + 1> levels{};
    for (std::size_t i = 0; i < num; ++i) {
        if (is_bright[i] & (is_changed_[i] ^ 1)) ++levels[static_cast<std::size_t>(level_of(i))];
    }
    const auto most = std::max_element(levels.begin(), levels.end());
    if (*most * rarely_filled < num_bright) return 0.0;
    std::int64_t num_same = 0, num_bright_of_level = 0;
    for (std::size_t i = 0; i < num; ++i) {
        if (level_of(i) != most - levels.begin()) continue;
        num_same += is_changed_[i] ^ 1;
        num_bright_of_level += is_bright[i];
    }
    const auto share = [](std::int64_t part, auto all) { return static_cast<double>(part) / static_cast<double>(all); };
    if (*most == 0 || share(*most, num_bright_of_level) <= filled_share) return 0.0;
    return std::min(share(num_same, num), share(*most, num_bright));
}

void ImageComparer::keep() {
    std::uint64_t sum = 0;
    for (std::size_t first = 0; first < now_.samples.size(); first += num_at_once) {
        const std::uint16_t* samples = now_.samples.data() + first;
        sum += std::accumulate(samples, samples + std::min(num_at_once, now_.samples.size() - first), 0U);
    }
    const auto mean = static_cast<std::uint32_t>(sum / std::max<std::size_t>(1, now_.samples.size()));
    std::rotate(are_bright_.begin(), are_bright_.begin() + 1, are_bright_.end());
    are_bright_.back().resize(now_.samples.size());
    std::transform(now_.samples.begin(), now_.samples.end(), are_bright_.back().begin(),
                   [mean](std::uint16_t sample) { return static_cast<std::uint16_t>(sample > mean); });
}

void ImageComparer::forget_samples() {
    for (auto& is_bright : are_bright_) is_bright.clear();
    was_changed_.clear();
    num_same_.clear();
}

void ImageComparer::reset() {
    now_ = Digest();
    forget_samples();
}

bool ImageComparer::compare(const ImageView& image, std::int32_t top, ImageChange& change) {
    const bool is_u8 = image.pixel_type == PixelType::u8;
    std::swap(before_, now_);
    ImageChange found;
    is_u8 ? digest<std::uint8_t>(image, found) : digest<std::uint16_t>(image, found);
    if (before_.width_px != now_.width_px || before_.height_px != now_.height_px ||
        before_.pixel_type != now_.pixel_type) {
        forget_samples();
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
    compare_samples(top, change);
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
        change.tiles[static_cast<std::size_t>(tile)] =
            num_samples ? static_cast<double>(num_changed) / static_cast<double>(num_samples) : 1.0;
    }
    const std::int64_t margin = grid.num_down / border_share * grid.num_across;
    std::vector<std::uint32_t> strongest((changes_.size() - 2 * static_cast<std::size_t>(margin)) / rare + 1);
    std::partial_sort_copy(changes_.begin() + margin, changes_.end() - margin, strongest.begin(), strongest.end(),
                           std::greater<>());
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
