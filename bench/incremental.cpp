// SPDX-License-Identifier: Apache-2.0
// How long local bundle adjustment takes in maps of several sizes: a window of 20 neighbouring
// images in the middle of a generated street, and what each way to change a map costs a solve of
// all of it.
//   bench/incremental [NUM_IMAGES ...]      500 2000 8000
#include <clba/clba.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <numeric>

namespace {

constexpr int32_t window_size = 20, num_repeats = 9, observations_per_image = 400;

template <class Work>
double seconds_of(Work&& work) {
    const auto begin = std::chrono::steady_clock::now();
    work();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

double median(std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
    return values[values.size() / 2];
}

std::vector<int32_t> images_from(int32_t first) {
    std::vector<int32_t> images(window_size);
    std::iota(images.begin(), images.end(), first);
    return images;
}

clba::SolverOptions options_of(int32_t num_iterations) {
    clba::SolverOptions options;
    options.max_num_iterations = num_iterations;
    options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 0;
    return options;
}

void print(const char* label, double seconds) {
    std::printf("  %-44s %10.4f s\n", label, seconds);
    std::fflush(stdout);
}

// An image like the last one of a problem, that sees what this sees.
class LastImage {
public:
    explicit LastImage(const clba::Problem& problem) : params_(3), model_(1), pose_(1) {
        const int32_t last = problem.info().num_images - 1;
        std::vector<int32_t> camera(1);
        problem.get_images(last, camera, pose_);
        problem.get_cameras(camera[0], model_, params_);
        const clba::Observations all = problem.observations();
        for (size_t i = 0; i < all.images.size(); ++i) {
            if (all.images[i] != last) continue;
            points_.push_back(all.points[i]);
            xy_.push_back(all.xy[i]);
        }
    }
    void append_to(clba::Problem& problem) const {
        const clba::ProblemInfo info = problem.info();
        problem.add_cameras(model_, params_);
        problem.add_images(std::vector<int32_t>{info.num_cameras}, pose_);
        problem.add_observations(std::vector<int32_t>(points_.size(), info.num_images), points_,
                                 xy_);
    }

private:
    std::vector<double> params_;
    std::vector<int32_t> model_, points_;
    std::vector<std::array<double, 7>> pose_;
    std::vector<std::array<double, 2>> xy_;
};

void measure(const clba::Context& context, int32_t num_images) {
    clba::SceneOptions scene;
    scene.scene = CLBA_SCENE_STREET;
    scene.num_images = num_images;
    scene.observations_per_image = observations_per_image;
    clba::Problem problem = std::move(clba::generate(scene).start);
    const clba::ProblemInfo info = problem.info();
    std::printf("%d images, %d points, %lld observations\n", info.num_images, info.num_points,
                static_cast<long long>(info.num_observations));

    const LastImage last_image(problem);
    const clba::SolverOptions ten = options_of(10);
    clba::Window first(images_from(0));
    print("first window, with the lists of observations",
          seconds_of([&] { problem.solve_window(context, first, ten); }));
    std::vector<double> seconds;
    clba::Window window(images_from(num_images / 2));
    for (int32_t i = 0; i < num_repeats; ++i) {
        clba::Window next(images_from(num_images / 2 - 10 * i));
        seconds.push_back(seconds_of([&] { problem.solve_window(context, next, ten); }));
        window = next;
    }
    std::printf("  a window: %d images and %d points free, %d images constant, %lld observations\n",
                window_size, window.num_free_points, window.num_constant_images,
                static_cast<long long>(window.num_observations));
    print("10 iterations on a window (median)", median(seconds));
    seconds.clear();
    for (int32_t i = 0; i < num_repeats; ++i)
        seconds.push_back(seconds_of([&] {
            last_image.append_to(problem);
            clba::Window latest(images_from(problem.info().num_images - window_size));
            problem.solve_window(context, latest, ten);
        }));
    print("an image appended, and a window on the latest", median(seconds));

    // What a solve of all takes before its first iteration.
    const auto setup_after = [&](const char* label, auto&& change) {
        std::vector<double> times;
        for (int32_t i = 0; i < num_repeats; ++i) {
            change();
            times.push_back(problem.solve(context, options_of(0)).summary().setup_seconds);
        }
        print(label, median(times));
    };
    const std::vector<int32_t> none(static_cast<size_t>(problem.info().num_images), 0);
    setup_after("set-up of a solve of all: nothing changed", [] {});
    setup_after("  constants changed", [&] { problem.set_constant_images(none); });
    setup_after("  an image appended", [&] { last_image.append_to(problem); });
    const clba::Observations all = problem.observations();
    clba::Observations other = all;
    for (auto* rows : {&other.images, &other.points}) std::reverse(rows->begin(), rows->end());
    std::reverse(other.xy.begin(), other.xy.end());
    int32_t turn = 0;
    setup_after("  other observations", [&] {
        const clba::Observations& next = turn++ % 2 == 0 ? other : all;
        problem.set_observations(next.images, next.points, next.xy);
    });
}

}  // namespace

int main(int argc, char** argv) try {
    const clba::Context context;
    std::vector<int32_t> sizes = {500, 2000, 8000};
    if (argc > 1) sizes.clear();
    for (int i = 1; i < argc; ++i) sizes.push_back(std::atoi(argv[i]));
    // Builds the kernels.
    clba::Problem warm = std::move(clba::generate().start);
    clba::Window window(images_from(0));
    warm.solve_window(context, window, options_of(2));
    warm.solve(context, options_of(1));
    for (const int32_t num_images : sizes) measure(context, num_images);
    return EXIT_SUCCESS;
} catch (const clba::Error& error) {
    std::fprintf(stderr, "incremental: %s\n", error.what());
    return EXIT_FAILURE;
}
