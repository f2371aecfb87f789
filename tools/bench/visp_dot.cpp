// ViSP's blob tracker on frames from stdin, for the benchmark: visp_dot WIDTH HEIGHT COUNT U V < grey levels
// One line a frame: u v nanoseconds, or "lost".
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include <visp3/blob/vpDot2.h>
#include <visp3/core/vpException.h>
#include <visp3/core/vpImage.h>

int main(int argc, char **argv) {
    if (argc != 6) {
        return 2;
    }
    const unsigned width = static_cast<unsigned>(std::atoi(argv[1]));
    const unsigned height = static_cast<unsigned>(std::atoi(argv[2]));
    const int count = std::atoi(argv[3]);
    const size_t pixels = static_cast<size_t>(width) * height;
    std::vector<vpImage<unsigned char>> pictures(static_cast<size_t>(count), vpImage<unsigned char>(height, width));
    for (auto &picture : pictures) { // all before the clock starts: none of them is in the cache when its turn comes
        if (std::fread(picture.bitmap, 1, pixels, stdin) != pixels) {
            return 1;
        }
    }
    vpDot2 dot;
    for (int k = 0; k < count; k++) {
        const vpImage<unsigned char> &picture = pictures[static_cast<size_t>(k)];
        try {
            if (k == 0) {
                dot.initTracking(picture, vpImagePoint(std::atof(argv[5]), std::atof(argv[4])));
            }
            const auto start = std::chrono::steady_clock::now();
            dot.track(picture);
            const auto end = std::chrono::steady_clock::now();
            const long long ns = std::chrono::duration_cast<std::chrono::nanoseconds>(end - start).count();
            std::printf("%.6f %.6f %lld\n", dot.getCog().get_u(), dot.getCog().get_v(), ns);
        } catch (const vpException &) {
            std::printf("lost\n");
        }
    }
    return 0;
}
