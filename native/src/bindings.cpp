// The Python face of the core: takes arrays that `foreglow` has checked, releases the GIL, returns arrays.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <vector>

#include "foreglow/crops.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using PixelArray = nb::ndarray<nb::ro, nb::ndim<2>, nb::device::cpu>;
using BoxArray = nb::ndarray<const std::int32_t, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;

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

auto extract_crops(const PixelArray& image, const BoxArray& boxes, std::int32_t support, std::int32_t size_px) {
    if (support < 1 || size_px < 1) throw nb::value_error("support, size_px: expected at least 1");
    const foreglow::ImageView view = view_of(image);
    const std::size_t num_boxes = boxes.shape(0), size = static_cast<std::size_t>(size_px);
    float* crops = new float[num_boxes * size * size];
    nb::capsule owner(crops, [](void* pointer) noexcept { delete[] static_cast<float*>(pointer); });
    {
        nb::gil_scoped_release released;
        static_assert(sizeof(foreglow::Box) == 4 * sizeof(std::int32_t));
        foreglow::extract_crops(view, reinterpret_cast<const foreglow::Box*>(boxes.data()), num_boxes, support, size_px,
                                crops);
    }
    return nb::ndarray<nb::numpy, float, nb::ndim<4>>(crops, {num_boxes, 1, size, size}, owner);
}

}  // namespace

NB_MODULE(_native, module) {
    module.doc() = "The C++ core of Foreglow; use it through foreglow.proposals and foreglow.classifier.";
    module.def("extract_crops", &extract_crops, "image"_a, "boxes_xyxy_px"_a, "support"_a, "size_px"_a,
               "Crops of `boxes_xyxy_px` (N, 4) int32 as float32 (N, 1, size_px, size_px) in [0, 1].");
}
