// The Python face of the core: takes arrays that `foreglow` has checked, releases the GIL where a call takes long,
// returns arrays.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "foreglow/box_light.hpp"
#include "foreglow/crops.hpp"
#include "foreglow/hypotheses.hpp"
#include "foreglow/image_change.hpp"
#include "foreglow/image_stripes.hpp"
#include "foreglow/lamp_pairs.hpp"
#include "foreglow/proposals.hpp"
#include "foreglow/twin_lights.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using PixelArray = nb::ndarray<nb::ro, nb::ndim<2>, nb::device::cpu>;
using BoxArray = nb::ndarray<const std::int32_t, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;
static_assert(sizeof(foreglow::Box) == 4 * sizeof(std::int32_t));
using Column = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <std::size_t width>
using Columns = nb::ndarray<const double, nb::shape<-1, static_cast<nb::ssize_t>(width)>, nb::c_contig, nb::device::cpu>;
// As foreglow.distance.hypotheses.Cells and BoxEvidence have them.
using CellArrays = std::array<Column, 7>;
using EvidenceArrays = std::tuple<Columns<2>, Columns<2>, Columns<foreglow::num_features>, Column>;

foreglow::ImageView view_of(const PixelArray& pixels) {
    foreglow::ImageView view;
    if (pixels.dtype() == nb::dtype<std::uint8_t>()) {
        view.pixel_type = foreglow::PixelType::u8;
    } else if (pixels.dtype() == nb::dtype<std::uint16_t>()) {
        view.pixel_type = foreglow::PixelType::u16;
    } else {
        throw nb::type_error("image: expected uint8 or uint16");
    }
    if (pixels.shape(1) > 1 && pixels.stride(1) != 1) throw nb::value_error("image: expected adjacent columns");
    const std::size_t pixel_bytes = view.pixel_type == foreglow::PixelType::u8 ? 1 : 2;
    view.data = pixels.data();
    view.height_px = static_cast<std::int32_t>(pixels.shape(0));
    view.width_px = static_cast<std::int32_t>(pixels.shape(1));
    view.row_stride_bytes = static_cast<std::ptrdiff_t>(pixels.stride(0)) * static_cast<std::ptrdiff_t>(pixel_bytes);
    return view;
}

template <typename Value, std::size_t num_axes>
auto owned(Value* values, const std::size_t (&shape)[num_axes]) {
    nb::capsule owner(values, [](void* pointer) noexcept { delete[] static_cast<Value*>(pointer); });
    return nb::ndarray<nb::numpy, Value, nb::ndim<num_axes>>(values, num_axes, shape, owner);
}

template <std::size_t size, std::size_t num_axes>
auto copied(const std::array<double, size>& values, const std::size_t (&shape)[num_axes]) {
    auto* copy = new double[size];
    std::copy(values.begin(), values.end(), copy);
    return owned(copy, shape);
}

nb::tuple extract_crops(const PixelArray& image, const BoxArray& boxes, std::int32_t support, std::int32_t size_px,
                        const std::optional<PixelArray>& earlier) {
    if (support < 1 || size_px < 1) throw nb::value_error("support, size_px: expected at least 1");
    const foreglow::ImageView view = view_of(image);
    foreglow::ImageView earlier_view;
    if (earlier) {
        earlier_view = view_of(*earlier);
        if (earlier_view.pixel_type != view.pixel_type || earlier_view.width_px != view.width_px ||
            earlier_view.height_px != view.height_px) {
            throw nb::value_error("earlier: expected an image of the same size and type");
        }
    }
    const std::size_t num_boxes = boxes.shape(0), size = static_cast<std::size_t>(size_px);
    const std::size_t num_channels = earlier ? 2 : 1;
    auto crops = owned(new float[num_boxes * num_channels * size * size], {num_boxes, num_channels, size, size});
    auto levels = owned(new float[num_boxes * 2], {num_boxes, 2});
    {
        nb::gil_scoped_release released;
        foreglow::extract_crops(view, earlier ? &earlier_view : nullptr,
                                reinterpret_cast<const foreglow::Box*>(boxes.data()), num_boxes, {support, size_px},
                                crops.data(), levels.data());
    }
    return nb::make_tuple(crops, levels);
}

foreglow::ProposalParameters parameters_from(const nb::dict& fields) {
    foreglow::ProposalParameters p;
    const auto read = [&](const char* name, auto& value) {
        value = nb::cast<std::remove_reference_t<decltype(value)>>(fields[name]);
    };
    read("kappa", p.kappa);
    read("window_px", p.window_px);
    read("eps", p.eps);
    read("min_deviation", p.min_deviation);
    read("gap_px", p.gap_px);
    read("min_area_px", p.min_area_px);
    read("max_area_px", p.max_area_px);
    read("min_width_px", p.min_width_px);
    read("split_saddle", p.split_saddle);
    read("reduction", p.reduction);
    read("reference_width_px", p.reference_width_px);
    read("normalise", p.normalise);
    read("blur_width_px", p.blur_width_px);
    read("blur_height_px", p.blur_height_px);
    read("blur_sigma_px", p.blur_sigma_px);
    p.window = nb::cast<std::string>(fields["window"]) == "centred" ? foreglow::Window::centred
                                                                    : foreglow::Window::published;
    if (!fields["region_xyxy_px"].is_none()) {
        const nb::object region = fields["region_xyxy_px"];
        p.region = foreglow::Box{nb::cast<std::int32_t>(region[0]), nb::cast<std::int32_t>(region[1]),
                                 nb::cast<std::int32_t>(region[2]), nb::cast<std::int32_t>(region[3])};
    }
    return p;
}

foreglow::ProposalGenerator make_generator(const nb::dict& parameters, const std::string& dispatch) {
    if (dispatch == "auto") return foreglow::ProposalGenerator(parameters_from(parameters));
    for (const auto known : {foreglow::Dispatch::baseline, foreglow::Dispatch::avx2, foreglow::Dispatch::avx512}) {
        if (dispatch == foreglow::name_of(known)) return foreglow::ProposalGenerator(parameters_from(parameters), known);
    }
    throw std::invalid_argument("dispatch: expected auto, baseline, avx2 or avx512, got " + dispatch);
}

auto propose(foreglow::ProposalGenerator& generator, const PixelArray& image) {
    const foreglow::ImageView view = view_of(image);
    const std::vector<foreglow::Box>* boxes = nullptr;
    {
        nb::gil_scoped_release released;
        boxes = &generator.propose(view);
    }
    auto* values = new std::int32_t[boxes->size() * 4];
    if (!boxes->empty()) std::memcpy(values, boxes->data(), boxes->size() * sizeof(foreglow::Box));
    return owned(values, {boxes->size(), 4});
}

nb::tuple light_of_boxes(const PixelArray& image, const BoxArray& boxes) {
    const foreglow::ImageView view = view_of(image);
    if (view.width_px < 1 || view.height_px < 1) throw nb::value_error("image: expected at least one pixel");
    const std::size_t num_boxes = boxes.shape(0);
    auto pixels = owned(new double[num_boxes * 2], {num_boxes, 2});
    auto peaks = owned(new double[num_boxes], {num_boxes});
    foreglow::light_of_boxes(view, reinterpret_cast<const foreglow::Box*>(boxes.data()), num_boxes, pixels.data(),
                             peaks.data());
    return nb::make_tuple(pixels, peaks);
}

auto twin_lights(const PixelArray& image, const BoxArray& boxes) {
    const foreglow::ImageView view = view_of(image);
    const std::size_t num_boxes = boxes.shape(0);
    auto columns = owned(new double[num_boxes * 2], {num_boxes, 2});
    foreglow::twin_lights(view, reinterpret_cast<const foreglow::Box*>(boxes.data()), num_boxes, columns.data());
    return columns;
}

auto pair_spacings(const Columns<2>& centres, const Columns<2>& sizes, const Column& contrasts) {
    const std::size_t num = contrasts.shape(0);
    if (centres.shape(0) != num || sizes.shape(0) != num) throw nb::value_error("boxes: expected arrays of one length");
    auto spacings = owned(new double[num], {num});
    foreglow::pair_spacings(centres.data(), sizes.data(), contrasts.data(), num, spacings.data());
    return spacings;
}

std::optional<foreglow::ImageChange> compare(foreglow::ImageComparer& comparer, const PixelArray& image, std::uint16_t top) {
    const foreglow::ImageView view = view_of(image);
    if (view.width_px < 1 || view.height_px < 1) throw nb::value_error("image: expected at least one pixel");
    if (top < 1) throw nb::value_error("top: expected at least 1");
    nb::gil_scoped_release released;
    foreglow::ImageChange change;
    return comparer.compare(view, top, change) ? std::optional(change) : std::nullopt;
}

std::optional<std::array<foreglow::Alternation, 2>> update_stripes(foreglow::ImageStripes& stripes, const PixelArray& image,
                                                                   std::uint16_t top) {
    const foreglow::ImageView view = view_of(image);
    if (view.width_px < 1 || view.height_px < 1) throw nb::value_error("image: expected at least one pixel");
    if (top < 1) throw nb::value_error("top: expected at least 1");
    nb::gil_scoped_release released;
    std::array<foreglow::Alternation, 2> found{};
    return stripes.update(view, top, found) ? std::optional(found) : std::nullopt;
}

foreglow::HypothesisWeigher make_weigher(const nb::dict& fields) {
    const auto read_from = [](const nb::handle& from, const char* name, auto& value) {
        value = nb::cast<std::remove_reference_t<decltype(value)>>(from[name]);
    };
    foreglow::HypothesisParameters p;
    for (const nb::handle kind : fields["kinds"]) {
        foreglow::LightKind& k = p.kinds.emplace_back();
        read_from(kind, "side", k.side);
        read_from(kind, "offset_m", k.offset_m);
        read_from(kind, "height_m", k.height_m);
        read_from(kind, "offset_sigma_m", k.offset_sigma_m);
        read_from(kind, "height_sigma_m", k.height_sigma_m);
        read_from(kind, "is_lamp", k.is_lamp);
        read_from(kind, "is_anywhere", k.is_anywhere);
        read_from(kind, "log_share", k.log_share);
        read_from(kind, "log_range", k.log_range);
        read_from(kind, "features", k.features);
        read_from(kind, "feature_slopes", k.feature_slopes);
        read_from(kind, "pair_logit", k.pair_logit);
    }
    const auto read = [&](const char* name, auto& value) { read_from(fields, name, value); };
    read("places_m", p.places_m);
    read("cell_sigmas_m", p.cell_sigmas_m);
    read("log_cells", p.log_cells);
    read("range_log_sigma", p.range_log_sigma);
    read("pixel_sigma_rad", p.pixel_sigma_rad);
    read("slope_sigma", p.slope_sigma);
    read("anywhere_sigma_rad", p.anywhere_sigma_rad);
    read("plane_sigma_rad", p.plane_sigma_rad);
    read("roll_sigma_rad", p.roll_sigma_rad);
    read("impossible", p.impossible);
    read("feature_sigmas", p.feature_sigmas);
    read("box_shares", p.box_shares);
    read("reference_log_range", p.reference_log_range);
    read("spacing_log_sigma", p.spacing_log_sigma);
    read("pair_share", p.pair_share);
    read("pair_log_sigma", p.pair_log_sigma);
    read("pair_log_mean", p.pair_log_mean);
    return foreglow::HypothesisWeigher(p);
}

auto cells_along(const foreglow::HypothesisWeigher& weigher, const nb::object& road,
                 const std::array<double, 3>& camera_m, double pitch_sigma_rad) {
    const foreglow::HypothesisParameters& parameters = weigher.parameters();
    const std::size_t num_places = parameters.places_m.size();
    const std::size_t num = num_places * parameters.kinds.size();
    auto columns = owned(new double[7 * num], {7, num});
    if (road.is_none()) {
        foreglow::cells_along(parameters, nullptr, camera_m, pitch_sigma_rad, columns.data());
        return columns;
    }
    foreglow::Ribbon ribbon;
    std::vector<nb::ndarray<>> kept;  // arrays that had to be converted live as long as their pointers
    const auto array = [&](const char* name, auto& values) {
        using Value = std::remove_const_t<std::remove_pointer_t<std::remove_reference_t<decltype(values)>>>;
        const auto found = nb::cast<nb::ndarray<const Value, nb::shape<-1, 1>, nb::c_contig, nb::device::cpu>>(
            road.attr(name));
        if (found.shape(0) != num_places) throw nb::value_error("road: expected an entry for each place");
        values = found.data();
        kept.emplace_back(found);
    };
    const auto number = [&](const char* name, double& value) { value = nb::cast<double>(road.attr(name)); };
    array("x_m", ribbon.x_m);
    array("y_m", ribbon.y_m);
    array("z_m", ribbon.z_m);
    array("cos", ribbon.cos);
    array("sin", ribbon.sin);
    array("slope", ribbon.slope);
    array("banking", ribbon.banking);
    array("crown", ribbon.crown);
    array("is_known", ribbon.is_known);
    number("half_width_m", ribbon.half_width_m);
    number("lean", ribbon.lean);
    number("rise_m", ribbon.rise_m);
    number("curvature_per_m", ribbon.curvature_per_m);
    number("start_cos", ribbon.start_cos);
    number("start_sin", ribbon.start_sin);
    number("start_slope", ribbon.start_slope);
    number("shift_sigma_m", ribbon.shift_sigma_m);
    number("yaw_sigma_rad", ribbon.yaw_sigma_rad);
    number("left_sigma_m", ribbon.left_sigma_m);
    foreglow::cells_along(parameters, &ribbon, camera_m, pitch_sigma_rad, columns.data());
    return columns;
}

auto quantiles(foreglow::HypothesisWeigher& weigher, const CellArrays& cells, const EvidenceArrays& boxes,
               const std::vector<double>& shares) {
    const auto& [directions, sizes, features, pairs] = boxes;
    const std::size_t num_boxes = pairs.shape(0);
    for (const Column& column : cells) {
        if (column.shape(0) != cells[0].shape(0)) throw nb::value_error("cells: expected arrays of one length");
    }
    if (directions.shape(0) != num_boxes || sizes.shape(0) != num_boxes || features.shape(0) != num_boxes) {
        throw nb::value_error("boxes: expected arrays of one length");
    }
    auto found = owned(new double[shares.size() * num_boxes], {shares.size(), num_boxes});
    weigher.quantiles({cells[0].shape(0), cells[0].data(), cells[1].data(), cells[2].data(), cells[3].data(),
                       cells[4].data(), cells[5].data(), cells[6].data()},
                      {num_boxes, directions.data(), sizes.data(), features.data(), pairs.data()}, shares, found.data());
    return found;
}

}  // namespace

NB_MODULE(_native, module) {
    module.doc() = "The C++ core of Foreglow; use it through foreglow.proposals, foreglow.classifier and foreglow.distance.";
    module.def("extract_crops", &extract_crops, "image"_a, "boxes_xyxy_px"_a, "support"_a, "size_px"_a,
               "earlier"_a = nb::none(),
               "Crops of `boxes_xyxy_px` (N, 4) int32 as float32 (N, C, size_px, size_px) in [0, 1], and their levels.");
    nb::class_<foreglow::ProposalGenerator>(module, "ProposalGenerator", "Finds proposals; one object a thread.")
        .def(nb::new_(&make_generator), "parameters"_a, "dispatch"_a)
        .def("propose", &propose, "image"_a, "Boxes (N, 4) int32 of a grey image, half-open, full-frame pixels.")
        .def_prop_ro("dispatch", [](const foreglow::ProposalGenerator& g) { return foreglow::name_of(g.dispatch()); })
        .def_prop_ro("num_doubtful", &foreglow::ProposalGenerator::num_doubtful,
                     "Pixels of the last frame that double precision had to decide.");
    module.def("light_of_boxes", &light_of_boxes, "image"_a, "boxes_xyxy_px"_a,
               "Where the light of each box is, pixels (N, 2), and its peak over the surroundings (N,) of full scale.");
    module.def("twin_lights", &twin_lights, "image"_a, "boxes_xyxy_px"_a,
               "The columns of the left and the right light of each box, pixels (N, 2); NaN without just two.");
    module.def("pair_spacings", &pair_spacings, "centres_rad"_a, "sizes_rad"_a, "contrasts"_a,
               "How far each box is from its partner (N,), radians; NaN without one.");
    nb::class_<foreglow::ImageChange>(module, "ImageChange", "What differs between two images.")
        .def_ro("strongest", &foreglow::ImageChange::strongest)
        .def_prop_ro("tiles", [](const foreglow::ImageChange& change) {
            return copied(change.tiles, {foreglow::num_change_tiles, foreglow::num_change_tiles});
        }, nb::rv_policy::automatic)
        .def_ro("num_samples", &foreglow::ImageChange::num_samples)
        .def_ro("num_changed", &foreglow::ImageChange::num_changed)
        .def_ro("num_bright", &foreglow::ImageChange::num_bright)
        .def_ro("share_stuck", &foreglow::ImageChange::share_stuck)
        .def_ro("num_textured", &foreglow::ImageChange::num_textured)
        .def_ro("share_stuck_texture", &foreglow::ImageChange::share_stuck_texture)
        .def_ro("share_same_long", &foreglow::ImageChange::share_same_long)
        .def_ro("share_filled", &foreglow::ImageChange::share_filled)
        .def_ro("contrast", &foreglow::ImageChange::contrast)
        .def_ro("num_edges", &foreglow::ImageChange::num_edges)
        .def_ro("num_other_edges", &foreglow::ImageChange::num_other_edges)
        .def_ro("num_rows", &foreglow::ImageChange::num_rows)
        .def_ro("num_repeated_rows", &foreglow::ImageChange::num_repeated_rows)
        .def_ro("share_flat_rows", &foreglow::ImageChange::share_flat_rows)
        .def_ro("share_flat_pieces", &foreglow::ImageChange::share_flat_pieces)
        .def_prop_ro("pair_ratios", [](const foreglow::ImageChange& change) {
            return copied(change.pair_ratios, {2, 2});
        }, nb::rv_policy::automatic);
    nb::class_<foreglow::ImageComparer>(module, "ImageComparer",
                                        "Compares each image with the one before; one object a thread.")
        .def(nb::init<>())
        .def("compare", &compare, "image"_a, "top"_a,
             "None for the first image, and where the size or the type is another.")
        .def("keep", &foreglow::ImageComparer::keep,
             "Makes the latest image one that, after two others, says which samples are bright.")
        .def("reset", &foreglow::ImageComparer::reset);
    nb::class_<foreglow::ImageStripes>(module, "ImageStripes",
                                       "How much neighbouring rows and columns change in turn; one object a thread.")
        .def(nb::init<>())
        .def("update", &update_stripes, "image"_a, "top"_a,
             "By rows and by columns; None for the first image, and where the size or the type is another.")
        .def("reset", &foreglow::ImageStripes::reset);
    nb::class_<foreglow::HypothesisWeigher>(module, "HypothesisWeigher",
                                            "Weighs hypotheses of ranges; one object a thread.")
        .def(nb::new_(&make_weigher), "parameters"_a)
        .def("cells_along", &cells_along, "road"_a.none(), "camera_m"_a, "pitch_sigma_rad"_a,
             "The hypotheses along a ribbon, or without one: the seven columns of Cells (7, C).")
        .def("quantiles", &quantiles, "cells"_a, "boxes"_a, "shares"_a,
             "Weighted quantiles (S, N) of the cells' log ranges, for each of `shares` and each box.");
    module.def("available_dispatch", [] {
        std::vector<std::string> names;
        for (const auto dispatch : foreglow::available_dispatch()) names.emplace_back(foreglow::name_of(dispatch));
        return names;
    }, "Instruction sets that this processor can run, weakest first.");
}
