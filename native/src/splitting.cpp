#include "splitting.hpp"

#include <algorithm>

#include "bits.hpp"

namespace foreglow {

void BlobSplitter::start(std::int64_t width, std::int64_t height) {
    num_words_ = 2 * ((width + 127) / 128);
    bits_.resize(static_cast<std::size_t>(num_words_ * height));
    y_ = 0;
}

void BlobSplitter::add_row(const BinaryRow& row) {
    std::uint64_t* words = bits_.data() + y_ * num_words_;
    for (std::int64_t word = 0; word < num_words_ / 2; ++word) {
        const std::uint64_t even = row.even[word], odd = row.odd[word];
        words[2 * word] = words[2 * word + 1] = 0;
        if ((even | odd) == 0) continue;
        words[2 * word] = interleaved(even, odd);
        words[2 * word + 1] = interleaved(even >> 32, odd >> 32);
    }
    ++y_;
}

std::int32_t BlobSplitter::root(std::int32_t part) {
    while (parts_[part].parent != part) {
        parts_[part].parent = parts_[parts_[part].parent].parent;
        part = parts_[part].parent;
    }
    return part;
}

// The set pixels with their levels, row by row, and how many there are of each level.
template <typename Sum>
void BlobSplitter::collect(const Box& box, const WorkingImage& image, std::int64_t black, std::int64_t range) {
    pixels_.clear();
    const std::int64_t whole = 16 * range, dark = 16 * black;
    for (std::int64_t y = box.y1; y < box.y2; ++y) {
        const Sum* row = image.row<Sum>(y);
        const Sum* above = image.row<Sum>(mirrored(y - 1, image.height));
        const Sum* below = image.row<Sum>(mirrored(y + 1, image.height));
        const std::uint64_t* words = bits_.data() + y * num_words_;
        for (std::int64_t word = box.x1 >> 6; word <= (box.x2 - 1) >> 6; ++word) {
            const std::int64_t first = word * 64;
            std::uint64_t bits = words[word];
            if (first < box.x1) bits &= ~0ULL << (box.x1 - first);
            if (first + 64 > box.x2) bits &= ~0ULL >> (first + 64 - box.x2);
            for (; bits != 0; bits &= bits - 1) {
                const std::int64_t x = first + __builtin_ctzll(bits);
                const auto across = [x](const Sum* sums) {
                    return std::int64_t{sums[x - 1]} + 2 * std::int64_t{sums[x]} + std::int64_t{sums[x + 1]};
                };
                const std::int64_t light = across(above) + 2 * across(row) + across(below) - dark;
                const auto level = static_cast<std::int16_t>(light * top_level / whole);
                pixels_.push_back({level, static_cast<std::int32_t>(x - box.x1), static_cast<std::int32_t>(y - box.y1)});
            }
        }
    }
}

// From the highest level down, in their order where levels are equal.
void BlobSplitter::sort() {
    starts_.assign(top_level + 2, 0);
    for (const Pixel& pixel : pixels_) ++starts_[top_level - pixel.level + 1];
    for (std::size_t i = 1; i < starts_.size(); ++i) starts_[i] += starts_[i - 1];
    sorted_.resize(pixels_.size());
    for (const Pixel& pixel : pixels_) sorted_[starts_[top_level - pixel.level]++] = pixel;
}

void BlobSplitter::widen(Part& part, const Box& box) {
    if (part.is_closed) return;
    part.extent = {std::min(part.extent.x1, box.x1), std::min(part.extent.y1, box.y1),
                   std::max(part.extent.x2, box.x2), std::max(part.extent.y2, box.y2)};
}

void BlobSplitter::flood(std::int32_t width, std::int32_t height, const SplitRule& rule) {
    const std::int32_t stride = width + 2;
    part_of_.assign(static_cast<std::size_t>(stride) * (height + 2), -1);
    parts_.clear();
    const std::int32_t around[8] = {-stride - 1, -stride, -stride + 1, -1, 1, stride - 1, stride, stride + 1};
    for (const Pixel& pixel : sorted_) {
        const std::int32_t place = (pixel.y + 1) * stride + pixel.x + 1;
        std::int32_t met[8], num_met = 0, highest = -1, last = -1;
        for (const std::int32_t step : around) {
            const std::int32_t part = part_of_[place + step];
            if (part < 0 || part == last) continue;
            last = part;
            const std::int32_t found = root(part);
            if (std::find(met, met + num_met, found) != met + num_met) continue;
            // In the order of their peaks: what closes a part must not depend on where it was met.
            std::int32_t at = num_met++;
            for (; at > 0 && met[at - 1] > found; --at) met[at] = met[at - 1];
            met[at] = found;
            // The earlier of two equal peaks counts as the higher one.
            if (highest < 0 || parts_[found].peak > parts_[highest].peak ||
                (parts_[found].peak == parts_[highest].peak && found < highest)) {
                highest = found;
            }
        }
        if (highest < 0) {
            highest = static_cast<std::int32_t>(parts_.size());
            parts_.push_back({highest, pixel.level, 0, {pixel.x, pixel.y, pixel.x + 1, pixel.y + 1}});
        }
        part_of_[place] = highest;
        Part& whole = parts_[highest];
        ++whole.num_pixels;
        widen(whole, {pixel.x, pixel.y, pixel.x + 1, pixel.y + 1});
        for (std::int32_t i = 0; i < num_met; ++i) {
            Part& part = parts_[met[i]];
            if (met[i] == highest) continue;
            // A closed box could not show what it takes in.
            const bool is_deep = whole.is_closed ||
                                 static_cast<double>(pixel.level) <= rule.saddle * static_cast<double>(part.peak);
            if (is_deep && static_cast<double>(part.num_pixels) >= rule.min_area_px) {
                part.is_closed = whole.is_closed = true;
                continue;
            }
            part.parent = highest;
            whole.num_pixels += part.num_pixels;
            widen(whole, part.extent);
        }
    }
}

void BlobSplitter::split(const Box& box, const WorkingImage& image, std::int64_t black, std::int64_t range,
                         const SplitRule& rule, std::vector<Box>& parts) {
    if (image.is_narrow) {
        collect<std::uint16_t>(box, image, black, range);
    } else {
        collect<std::uint32_t>(box, image, black, range);
    }
    sort();
    flood(box.x2 - box.x1, box.y2 - box.y1, rule);
    const std::size_t before = parts.size();
    for (std::size_t i = 0; i < parts_.size(); ++i) {
        const Box& extent = parts_[i].extent;
        const auto width = static_cast<double>(extent.x2 - extent.x1), height = static_cast<double>(extent.y2 - extent.y1);
        if (parts_[i].parent != static_cast<std::int32_t>(i) || width * height < rule.min_area_px ||
            width < rule.min_width_px) {
            continue;
        }
        parts.push_back({box.x1 + extent.x1, box.y1 + extent.y1, box.x1 + extent.x2, box.y1 + extent.y2});
    }
    if (parts.size() < before + 2) {
        parts.resize(before);
        parts.push_back(box);
    }
}

}  // namespace foreglow
