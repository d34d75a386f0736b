// Tests of the core without Python; meant to run under the address and undefined-behaviour sanitizers.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "../src/blobs.hpp"
#include "../src/taps.hpp"
#include "foreglow/box_light.hpp"
#include "foreglow/crops.hpp"
#include "foreglow/hypotheses.hpp"
#include "foreglow/image_change.hpp"
#include "foreglow/lamp_pairs.hpp"
#include "foreglow/proposals.hpp"
#include "foreglow/twin_lights.hpp"

namespace {

using foreglow::Box;

int num_failed = 0, num_passed = 0;

void expect(bool holds, const char* what) {
    (holds ? num_passed : num_failed) += 1;
    if (!holds) std::printf("FAILED: %s\n", what);
}

bool before(const Box& a, const Box& b) {
    return std::tie(a.y1, a.x1, a.y2, a.x2) < std::tie(b.y1, b.x1, b.y2, b.x2);
}

// Noise, lamps and a gradient, in rows that are longer than the image is wide. The pixels lie on the heap exactly as
// large as they must be, so that the sanitizer sees every read beyond them.
template <typename Pixel>
struct Scene {
    std::vector<Pixel> pixels;
    foreglow::ImageView view;

    Scene(std::int32_t width, std::int32_t height, std::int32_t spare, unsigned seed) {
        std::mt19937 random(seed);
        const std::int64_t stride = width + spare, white = sizeof(Pixel) == 1 ? 255 : 65535;
        pixels.resize(static_cast<std::size_t>(stride * (height - 1) + width));
        for (std::size_t i = 0; i < pixels.size(); ++i) {
            const auto y = static_cast<std::int64_t>(i) / stride;
            pixels[i] = static_cast<Pixel>(y * white / (8 * height) + static_cast<std::int64_t>(random() % 4U));
        }
        for (int lamp = 0; lamp < 6; ++lamp) {
            const auto left = static_cast<std::int32_t>(random() % static_cast<unsigned>(width));
            const auto top = static_cast<std::int32_t>(random() % static_cast<unsigned>(height));
            const auto side = static_cast<std::int32_t>(3 + random() % 30U);
            for (std::int32_t y = top; y < std::min(height, top + side); ++y) {
                for (std::int32_t x = left; x < std::min(width, left + side); ++x) {
                    pixels[static_cast<std::size_t>(y * stride + x)] = static_cast<Pixel>(white - lamp * white / 9);
                }
            }
        }
        view.data = pixels.data();
        view.width_px = width;
        view.height_px = height;
        view.row_stride_bytes = static_cast<std::ptrdiff_t>(stride) * static_cast<std::ptrdiff_t>(sizeof(Pixel));
        view.pixel_type = sizeof(Pixel) == 1 ? foreglow::PixelType::u8 : foreglow::PixelType::u16;
    }
};

// Joins pixels pair by pair: slow and plain.
std::vector<Box> blobs_by_hand(const std::vector<std::pair<int, int>>& pixels, int gap_px) {
    std::vector<std::size_t> parents(pixels.size());
    for (std::size_t i = 0; i < parents.size(); ++i) parents[i] = i;
    const auto root = [&](std::size_t i) {
        while (parents[i] != i) i = parents[i];
        return i;
    };
    for (std::size_t i = 0; i < pixels.size(); ++i) {
        for (std::size_t j = 0; j < i; ++j) {
            const int apart = std::max(std::abs(pixels[i].first - pixels[j].first),
                                       std::abs(pixels[i].second - pixels[j].second));
            if (apart <= gap_px) parents[root(i)] = root(j);
        }
    }
    std::vector<Box> boxes;
    for (std::size_t blob = 0; blob < pixels.size(); ++blob) {
        if (root(blob) != blob) continue;
        Box box = {1 << 30, 1 << 30, -1, -1};
        for (std::size_t i = 0; i < pixels.size(); ++i) {
            if (root(i) != blob) continue;
            box = {std::min(box.x1, pixels[i].first), std::min(box.y1, pixels[i].second),
                   std::max(box.x2, pixels[i].first + 1), std::max(box.y2, pixels[i].second + 1)};
        }
        boxes.push_back(box);
    }
    return boxes;
}

void test_blobs_equal_pairwise_joining() {
    std::mt19937 random(1);
    foreglow::BlobFinder finder;
    for (int round = 0; round < 300; ++round) {
        const int gap_px = 1 + static_cast<int>(random() % 9U), height = 1 + static_cast<int>(random() % 40U);
        const unsigned sparseness = 2 + random() % 60U;
        std::vector<std::pair<int, int>> pixels;
        finder.start(gap_px);
        for (int y = 0; y < height; ++y) {
            std::uint64_t even[2] = {0, 0}, odd[2] = {0, 0};
            for (int x = 0; x < 256; ++x) {
                if (random() % (sparseness * 10) != 0 && !(sparseness < 4 && x > 200 && x < 230)) continue;
                std::uint64_t* plane = x % 2 != 0 ? odd : even;
                plane[x / 128] |= 1ULL << (x % 128 / 2);
                pixels.emplace_back(x, y);
            }
            finder.add_row(even, odd, 2);
        }
        std::vector<Box> found = finder.boxes(), wanted = blobs_by_hand(pixels, gap_px);
        std::sort(found.begin(), found.end(), before);
        std::sort(wanted.begin(), wanted.end(), before);
        expect(found == wanted, "blobs equal those joined pair by pair");
    }
}

template <typename Pixel>
void test_all_dispatch_levels_agree() {
    const std::int32_t sizes[][2] = {{1, 1}, {2, 1}, {1, 9}, {64, 64}, {65, 33}, {127, 50}, {130, 129}, {333, 77},
                                     {640, 480}, {1280, 96}, {1283, 101}, {3001, 40}};
    for (const auto& size : sizes) {
        for (const bool is_fine : {false, true}) {
            const Scene<Pixel> scene(size[0], size[1], size[0] % 7, static_cast<unsigned>(size[0]));
            foreglow::ProposalParameters parameters;
            if (is_fine) {
                parameters.kappa = 0.3;
                parameters.window_px = 31;
                parameters.min_deviation = 0.0;
                parameters.gap_px = 2;
                parameters.min_area_px = 0.0;
                parameters.max_area_px = 1e9;
                parameters.min_width_px = 0.0;
                parameters.split_saddle = size[0] % 2 == 0 ? 0.6 : 1.0;
                parameters.reduction = 1;
                parameters.reference_width_px = size[0] < 64 ? 64 : size[0];
            }
            parameters.window = is_fine ? foreglow::Window::centred : foreglow::Window::published;
            std::vector<Box> first;
            for (const auto dispatch : foreglow::available_dispatch()) {
                foreglow::ProposalGenerator generator(parameters, dispatch);
                generator.propose(scene.view);
                const std::vector<Box> boxes = generator.propose(scene.view);
                if (dispatch == foreglow::Dispatch::baseline) first = boxes;
                expect(boxes == first, "every dispatch level finds the same boxes");
                for (const Box& box : boxes) {
                    expect(box.x1 >= 0 && box.y1 >= 0 && box.x1 < box.x2 && box.y1 < box.y2 && box.x2 <= size[0] &&
                               box.y2 <= size[1],
                           "boxes lie inside the image");
                }
            }
            if (size[0] >= 640) expect(!first.empty(), "a scene with lamps has proposals");
        }
    }
}

// Two lamps in one glow: one blob, split at the saddle between them where that is asked for.
void test_a_blob_is_split_at_a_deep_saddle() {
    std::vector<std::uint8_t> pixels(200 * 120, 10);
    for (int y = 0; y < 120; ++y) {
        for (int x = 0; x < 200; ++x) {
            const auto lamp = [&](int centre) {
                return 230.0 * std::exp(-((x - centre) * (x - centre) + (y - 60) * (y - 60)) / 500.0);
            };
            pixels[static_cast<std::size_t>(y * 200 + x)] = static_cast<std::uint8_t>(10.0 + lamp(70) + lamp(128));
        }
    }
    foreglow::ImageView view;
    view.data = pixels.data();
    view.pixel_type = foreglow::PixelType::u8;
    view.width_px = 200;
    view.height_px = 120;
    view.row_stride_bytes = 200;
    foreglow::ProposalParameters parameters;
    parameters.window_px = 101;
    parameters.kappa = 0.2;
    parameters.max_area_px = 1e9;
    parameters.reference_width_px = 200;
    const std::size_t whole = foreglow::ProposalGenerator(parameters).propose(view).size();
    parameters.split_saddle = 0.6;
    const std::vector<Box> parts = foreglow::ProposalGenerator(parameters).propose(view);
    expect(whole == 1 && parts.size() == 2, "two lamps in one glow are one blob, and two parts");
    expect(parts.size() == 2 && (parts[0].x2 <= parts[1].x1 || parts[1].x2 <= parts[0].x1), "the parts lie apart");
}

void test_sizes_may_change_between_frames() {
    foreglow::ProposalGenerator kept{foreglow::ProposalParameters{}};
    for (const std::int32_t width : {1280, 64, 2872, 1280, 640, 641, 1}) {
        const Scene<std::uint8_t> scene(width, width / 2 + 1, 3, 5);
        const std::vector<Box> boxes = kept.propose(scene.view);
        foreglow::ProposalGenerator fresh{foreglow::ProposalParameters{}};
        expect(boxes == fresh.propose(scene.view), "an earlier frame of another size leaves no trace");
    }
}

template <typename Pixel>
void test_crops_at_every_border() {
    const Scene<Pixel> scene(70, 41, 2, 3);
    std::vector<Box> boxes;
    for (std::int32_t x = -100; x < 170; x += 13) {
        for (std::int32_t y = -60; y < 110; y += 7) boxes.push_back({x, y, x + 1 + (x & 15), y + 1 + (y & 31)});
    }
    std::vector<float> crops(boxes.size() * 32 * 32, -1.0F);
    std::vector<float> levels(2 * boxes.size());
    foreglow::extract_crops(scene.view, nullptr, boxes.data(), boxes.size(), {2, 32}, crops.data(), levels.data());
    expect(std::all_of(crops.begin(), crops.end(), [](float value) { return value >= 0.0F && value <= 1.0F; }),
           "crops are written whole and lie in [0, 1]");
}

template <typename Pixel>
void test_light_at_every_border() {
    const Scene<Pixel> scene(70, 41, 2, 3);
    std::vector<Box> boxes;
    for (std::int32_t x = -100; x < 170; x += 13) {
        for (std::int32_t y = -60; y < 110; y += 7) boxes.push_back({x, y, x + 1 + (x & 15), y + 1 + (y & 31)});
    }
    std::vector<double> pixels(2 * boxes.size()), peaks(boxes.size());
    foreglow::light_of_boxes(scene.view, boxes.data(), boxes.size(), pixels.data(), peaks.data());
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        expect(pixels[2 * i] > boxes[i].x1 && pixels[2 * i] < boxes[i].x2 && pixels[2 * i + 1] > boxes[i].y1 &&
                   pixels[2 * i + 1] < boxes[i].y2 && peaks[i] >= 0.0 && peaks[i] <= 1.0,
               "the light of a box is in the box");
    }
}

template <typename Pixel>
void test_twins_at_every_border() {
    const Scene<Pixel> scene(70, 41, 2, 3);
    std::vector<Box> boxes{{-2147483647, -2147483647, 2147483647, 2147483647}, {60, 30, 2147483647, 2147483647}};
    for (std::int32_t x = -100; x < 170; x += 13) {
        for (std::int32_t y = -60; y < 110; y += 7) boxes.push_back({x, y, x + 1 + (x & 63), y + 1 + (y & 31)});
    }
    std::vector<double> columns(2 * boxes.size());
    foreglow::twin_lights(scene.view, boxes.data(), boxes.size(), columns.data());
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        const double left = columns[2 * i], right = columns[2 * i + 1];
        expect(std::isnan(left) == std::isnan(right), "a light has its twin, or there is none");
        expect(std::isnan(left) || (std::max(boxes[i].x1, 0) < left && left < right && right < std::min(boxes[i].x2, 70)),
               "twins are in their box and in the image, the left one first");
    }
}

template <typename Pixel>
void test_changes_of_images_of_any_size() {
    foreglow::ImageComparer comparer;
    foreglow::ImageChange change;
    for (const auto& [width, height] : {std::pair{1, 1}, {7, 40}, {40, 7}, {8, 8}, {17, 33}, {131, 97}}) {
        Scene<Pixel> scene(width, height, 3, 5);
        expect(!comparer.compare(scene.view, 255, change), "an image of another size is not compared");
        expect(comparer.compare(scene.view, 255, change) && change.strongest == 0.0 && change.num_changed == 0 &&
                   change.num_edges == 0 && change.num_other_edges == 0,
               "the same image again has not changed");
        for (Pixel& pixel : scene.pixels) pixel = static_cast<Pixel>(pixel + 1);
        expect(comparer.compare(scene.view, 255, change) && change.num_changed == change.num_samples,
               "every sample of a brighter image has changed");
        expect(change.num_bright == change.num_samples, "without a reference all samples are bright");
        for (int i = 0; i < 3; ++i) comparer.keep();
        expect(comparer.compare(scene.view, 255, change) && change.num_bright < change.num_samples,
               "not all samples are brighter than their mean");
    }
    comparer.reset();
    expect(!comparer.compare(Scene<Pixel>(131, 97, 3, 5).view, 255, change), "nothing is known after a reset");
}

void test_lamp_pairs() {
    const std::vector<double> centres = {0.013, 0.0, 0.4, 0.0, -0.013, 0.0005}, sizes(6, 0.006), contrasts(3, 200.0);
    std::vector<double> spacings(3);
    foreglow::pair_spacings(centres.data(), sizes.data(), contrasts.data(), 3, spacings.data());
    expect(std::abs(spacings[0] - 0.026) < 1e-12 && spacings[0] == spacings[2], "two like lamps are a pair");
    expect(std::isnan(spacings[1]), "a third lamp far away is alone");
    foreglow::pair_spacings(nullptr, nullptr, nullptr, 0, nullptr);
}

// Any number of kinds and places without a road, boxes of all sorts.
void test_weighing_at_all_dispatch_levels() {
    std::mt19937 random(4);
    const auto between = [&](double low, double high) {
        return std::uniform_real_distribution<double>(low, high)(random);
    };
    for (std::size_t num_kinds = 1; num_kinds < 6; ++num_kinds) {
        for (const std::size_t num_places : {1U, 2U, 5U, 16U, 33U}) {
            foreglow::HypothesisParameters parameters;
            for (std::size_t k = 0; k < num_kinds; ++k) {
                foreglow::LightKind& kind = parameters.kinds.emplace_back();
                kind.height_m = between(0.0, 1.0);
                kind.is_lamp = k % 2 == 0;
                kind.pair_logit = between(-1.0, 1.0);
                kind.features = {between(-1.0, 1.0), between(-1.0, 1.0), between(-1.0, 1.0)};
            }
            for (std::size_t place = 0; place < num_places; ++place) {
                parameters.places_m.push_back(5.0 + 7.0 * static_cast<double>(place));
            }
            parameters.cell_sigmas_m.assign(num_places, 1.0);
            parameters.log_cells.assign(num_places, 0.0);
            parameters.feature_sigmas = {0.7, 0.6, 0.5};
            parameters.pixel_sigma_rad = parameters.plane_sigma_rad = 0.001;
            parameters.anywhere_sigma_rad = 0.3;
            parameters.pair_share = 0.8;
            parameters.spacing_log_sigma = 0.1;
            const std::size_t num = num_kinds * num_places, num_boxes = 7;
            std::vector<double> columns(7 * num);
            foreglow::cells_along(parameters, nullptr, {2.0, 0.0, 1.25}, 0.002, columns.data());
            const double* at = columns.data();
            const foreglow::Cells cells = {num,          at,           at + num,     at + 2 * num,
                                           at + 3 * num, at + 4 * num, at + 5 * num, at + 6 * num};
            std::vector<double> directions(2 * num_boxes), sizes(2 * num_boxes), features(3 * num_boxes);
            std::vector<double> pairs(num_boxes, std::nan(""));
            for (double& value : directions) value = between(-0.1, 0.1);
            for (double& value : sizes) value = between(0.001, 0.02);
            for (double& value : features) value = between(-2.0, 2.0);
            pairs[2] = 3.0;
            pairs[5] = 4.0;
            const foreglow::BoxEvidence boxes = {num_boxes, directions.data(), sizes.data(), features.data(),
                                                 pairs.data()};
            std::vector<double> first;
            for (const auto dispatch : foreglow::available_dispatch()) {
                std::vector<double> found(3 * num_boxes);
                foreglow::HypothesisWeigher(parameters, dispatch).quantiles(cells, boxes, {0.2, 0.5, 0.8}, found.data());
                if (dispatch == foreglow::Dispatch::baseline) first = found;
                bool is_equal = true, is_rising = true;
                for (std::size_t i = 0; i < found.size(); ++i) {
                    is_equal = is_equal && std::abs(found[i] - first[i]) < 1e-9;
                    is_rising = is_rising && (i < num_boxes || found[i] >= found[i - num_boxes] - 1e-12);
                }
                expect(is_equal, "every dispatch level finds the same quantiles");
                expect(is_rising, "quantiles rise with their shares");
            }
        }
    }
}

void test_taps() {
    for (const double sigma_px : {0.3, 0.8, 2.0, 50.0}) {
        for (const std::int32_t size : {1, 3, 5}) {
            const auto kernel = foreglow::gaussian_taps(size, sigma_px);
            expect(std::abs(kernel[0] + 2 * kernel[1] + 2 * kernel[2] - 1.0) < 1e-12, "taps sum to one");
            const auto whole = foreglow::whole_taps(kernel, 1020);
            expect(whole.sum == whole.taps[0] + 2 * (whole.taps[1] + whole.taps[2]), "whole taps state their sum");
            expect(whole.error < (sigma_px >= 0.8 ? 1e-6 : 1e-4), "whole taps are as good as single precision");
        }
    }
    for (std::int64_t length = 1; length < 6; ++length) {
        for (std::int64_t i = -9; i < 15; ++i) {
            const std::int64_t inside = foreglow::mirrored(i, length);
            expect(inside >= 0 && inside < length, "mirrored indices lie inside");
        }
    }
    expect(foreglow::mirrored(-1, 4) == 1 && foreglow::mirrored(4, 4) == 2, "the border itself is not repeated");
}

void test_bad_parameters_are_refused() {
    foreglow::ProposalParameters parameters;
    parameters.gap_px = 0;
    bool is_refused = false;
    try {
        foreglow::ProposalGenerator generator(parameters);
    } catch (const std::invalid_argument&) {
        is_refused = true;
    }
    expect(is_refused, "a gap of 0 is refused");
}

}  // namespace

int main() {
    test_blobs_equal_pairwise_joining();
    test_all_dispatch_levels_agree<std::uint8_t>();
    test_all_dispatch_levels_agree<std::uint16_t>();
    test_a_blob_is_split_at_a_deep_saddle();
    test_sizes_may_change_between_frames();
    test_crops_at_every_border<std::uint8_t>();
    test_crops_at_every_border<std::uint16_t>();
    test_light_at_every_border<std::uint8_t>();
    test_light_at_every_border<std::uint16_t>();
    test_twins_at_every_border<std::uint8_t>();
    test_twins_at_every_border<std::uint16_t>();
    test_changes_of_images_of_any_size<std::uint8_t>();
    test_changes_of_images_of_any_size<std::uint16_t>();
    test_lamp_pairs();
    test_weighing_at_all_dispatch_levels();
    test_taps();
    test_bad_parameters_are_refused();
    std::printf("%d passed, %d failed\n", num_passed, num_failed);
    return num_failed == 0 ? 0 : 1;
}
