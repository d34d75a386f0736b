// Prints the proposals of a binary PGM image (P5, 8 or 16 bit), one "x1 y1 x2 y2" a line:
//   cmake -S native -B build/native && cmake --build build/native && build/native/propose_pgm frame.pgm
#include <algorithm>
#include <cstdio>
#include <exception>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include "foreglow/proposals.hpp"

namespace {

// The next number of a PGM header, skipping comments; -1 where there is none.
long header_number(std::istream& file) {
    while (file >> std::ws && file.peek() == '#') file.ignore(std::numeric_limits<std::streamsize>::max(), '\n');
    long number = -1;
    return file >> number ? number : -1;
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 2) {
        std::fprintf(stderr, "usage: propose_pgm frame.pgm\n");
        return 2;
    }
    std::ifstream file(argv[1], std::ios::binary);
    std::string magic(2, ' ');
    file.read(magic.data(), 2);
    const long width = header_number(file), height = header_number(file), white = header_number(file);
    if (!file || magic != "P5" || width < 1 || height < 1 || width > 16384 || height > 16384 || white < 1 ||
        white > 65535) {
        std::fprintf(stderr, "%s: expected a binary PGM (P5) of at most 16384 x 16384 pixels\n", argv[1]);
        return 2;
    }
    file.get();
    const bool is_wide = white > 255;
    const std::size_t pixel_bytes = is_wide ? 2 : 1;
    std::vector<char> pixels(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * pixel_bytes);
    if (!file.read(pixels.data(), static_cast<std::streamsize>(pixels.size()))) {
        std::fprintf(stderr, "%s: expected %zu bytes of pixels\n", argv[1], pixels.size());
        return 2;
    }
    if (is_wide) {  // PGM is big-endian
        for (std::size_t i = 0; i + 1 < pixels.size(); i += 2) std::swap(pixels[i], pixels[i + 1]);
    }

    try {
        foreglow::ImageView image;
        image.data = pixels.data();
        image.width_px = static_cast<std::int32_t>(width);
        image.height_px = static_cast<std::int32_t>(height);
        image.row_stride_bytes = static_cast<std::ptrdiff_t>(static_cast<std::size_t>(width) * pixel_bytes);
        image.pixel_type = is_wide ? foreglow::PixelType::u16 : foreglow::PixelType::u8;
        foreglow::ProposalGenerator generator{foreglow::ProposalParameters{}};
        for (const foreglow::Box& box : generator.propose(image)) {
            std::printf("%d %d %d %d\n", box.x1, box.y1, box.x2, box.y2);
        }
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s: %s\n", argv[1], error.what());
        return 2;
    }
    return 0;
}
