// SPDX-License-Identifier: Apache-2.0
// The C interface but for solving and evaluating: rules, arrays, structs, handles, files.
#include <clba/clba.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <limits>
#include <utility>

#include "api_rig.hpp"

namespace clba_test {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();

TEST(Status, HasATextForEveryNumber) {
    EXPECT_EQ(clba_version(), static_cast<uint32_t>(CLBA_VERSION));
    EXPECT_STREQ(clba_status_string(CLBA_OK), "ok");
    for (clba_status status = CLBA_ERROR_NO_PLUGIN; status < CLBA_OK; ++status) {
        EXPECT_STRNE(clba_status_string(status), "");
        EXPECT_STRNE(clba_status_string(status), clba_status_string(-1000));
    }
    EXPECT_STREQ(clba_status_string(17), clba_status_string(-1000));
}

TEST(Status, LastErrorIsOfTheLastCall) {
    EXPECT_TRUE(refused(clba_problem_create(nullptr), {"problem", "NULL"}));
    clba_problem* problem = nullptr;
    ASSERT_OK(clba_problem_create(&problem));
    EXPECT_STREQ(clba_last_error(), "");
    clba_problem_release(problem);
}

TEST(Names, OfEveryValueAndNoOther) {
    EXPECT_STREQ(clba_linear_solver_name(CLBA_LINEAR_SOLVER_PCG_SCHUR), "pcg_schur");
    EXPECT_STREQ(clba_linear_solver_name(CLBA_LINEAR_SOLVER_PCG_HESSIAN), "pcg_hessian");
    EXPECT_STREQ(clba_linear_solver_name(CLBA_LINEAR_SOLVER_DIRECT_SCHUR), "direct_schur");
    EXPECT_STREQ(clba_preconditioner_name(CLBA_PRECONDITIONER_DEFAULT), "default");
    EXPECT_STREQ(clba_preconditioner_name(CLBA_PRECONDITIONER_BLOCK_JACOBI), "block_jacobi");
    EXPECT_STREQ(clba_preconditioner_name(CLBA_PRECONDITIONER_SCHUR_JACOBI), "schur_jacobi");
    EXPECT_STREQ(clba_damping_name(CLBA_DAMPING_MARQUARDT), "marquardt");
    EXPECT_STREQ(clba_damping_name(CLBA_DAMPING_LEVENBERG), "levenberg");
    EXPECT_STREQ(clba_damping_name(CLBA_DAMPING_UNCERTAINTY), "uncertainty");
    EXPECT_STREQ(clba_precision_name(CLBA_PRECISION_AUTO), "auto");
    EXPECT_STREQ(clba_precision_name(CLBA_PRECISION_SINGLE), "single");
    EXPECT_STREQ(clba_precision_name(CLBA_PRECISION_DOUBLE), "double");
    EXPECT_STREQ(clba_precision_name(CLBA_PRECISION_MIXED), "mixed");
    EXPECT_STREQ(clba_loss_name(CLBA_LOSS_NONE), "none");
    EXPECT_STREQ(clba_loss_name(CLBA_LOSS_TUKEY), "tukey");
    EXPECT_STREQ(clba_scene_name(CLBA_SCENE_HALL), "hall");
    EXPECT_STREQ(clba_scene_name(CLBA_SCENE_LANDMARK), "landmark");
    for (auto* name :
         {clba_linear_solver_name, clba_preconditioner_name, clba_damping_name, clba_precision_name,
          clba_loss_name, clba_scene_name, clba_camera_model_name, clba_camera_model_param_names})
        for (int32_t value : {-1, 1000, std::numeric_limits<int32_t>::min()})
            EXPECT_EQ(name(value), nullptr);
    EXPECT_EQ(clba_linear_solver_name(0), nullptr);
    EXPECT_EQ(clba_scene_name(0), nullptr);
}

TEST(CameraModels, AreThoseOfTheHeader) {
    const std::pair<const char*, const char*> models[] = {
        {"snavely", "f,k1,k2"},
        {"simple_pinhole", "f,cx,cy"},
        {"pinhole", "fx,fy,cx,cy"},
        {"simple_radial", "f,cx,cy,k"},
        {"radial", "f,cx,cy,k1,k2"},
        {"opencv", "fx,fy,cx,cy,k1,k2,p1,p2"},
        {"opencv_fisheye", "fx,fy,cx,cy,k1,k2,k3,k4"},
        {"full_opencv", "fx,fy,cx,cy,k1,k2,p1,p2,k3,k4,k5,k6"},
        {"fov", "fx,fy,cx,cy,omega"},
        {"simple_radial_fisheye", "f,cx,cy,k"},
        {"radial_fisheye", "f,cx,cy,k1,k2"},
        {"thin_prism_fisheye", "fx,fy,cx,cy,k1,k2,p1,p2,k3,k4,sx1,sy1"},
        {"brown", "f,cx,cy,k1,k2,k3,p1,p2"},
    };
    ASSERT_EQ(clba_num_camera_models(), 13);
    EXPECT_EQ(CLBA_CAMERA_THIN_PRISM_FISHEYE, 11);
    for (int32_t model = 0; model < 13; ++model) {
        const std::string names = models[model].second;
        EXPECT_STREQ(clba_camera_model_name(model), models[model].first);
        EXPECT_EQ(clba_camera_model_param_names(model), names);
        EXPECT_EQ(clba_camera_model_num_params(model),
                  1 + std::count(names.begin(), names.end(), ','));
    }
    EXPECT_EQ(clba_camera_model_num_params(-1), -1);
    EXPECT_EQ(clba_camera_model_num_params(13), -1);
}

TEST(Devices, AreListed) {
    EXPECT_TRUE(refused(clba_num_devices(nullptr), {"num_devices", "NULL"}));
    int32_t count = 0;
    ASSERT_OK(clba_num_devices(&count));
    ASSERT_GT(count, 0);
    clba_device_info info;
    info.struct_size = sizeof info;
    for (int32_t i = 0; i < count; ++i) {
        ASSERT_OK(clba_get_device(i, &info));
        EXPECT_EQ(info.struct_size, sizeof info);
        EXPECT_EQ(info.index, i);
        EXPECT_GE(info.type, CLBA_DEVICE_CPU);
        EXPECT_LE(info.type, CLBA_DEVICE_OTHER);
        EXPECT_GT(info.compute_units, 0);
        EXPECT_LE(info.max_allocation_bytes, info.global_memory_bytes);
        EXPECT_STRNE(info.name, "");
        EXPECT_STRNE(info.platform, "");
    }
    EXPECT_TRUE(refused(clba_get_device(-1, &info), {"-1"}));
    EXPECT_TRUE(refused(clba_get_device(count, &info), CLBA_ERROR_NO_DEVICE, {"device"}));
    EXPECT_TRUE(refused(clba_get_device(0, nullptr), {"info", "NULL"}));
}

clba_context_options context_options() {
    clba_context_options options;
    EXPECT_OK(clba_context_options_init(&options, sizeof options));
    return options;
}

TEST(Contexts, TakeADeviceByIndexOrName) {
    clba_device_info first{};
    first.struct_size = sizeof first;
    ASSERT_OK(clba_get_device(0, &first));
    clba_context_options options = context_options();
    EXPECT_EQ(options.device_index, -1);
    const auto device_of = [&] {
        clba_context* context = nullptr;
        EXPECT_OK(clba_context_create(&options, &context));
        const Context owner(context);
        clba_device_info info{};
        info.struct_size = sizeof info;
        EXPECT_OK(clba_context_get_device(context, &info));
        return std::string(info.name);
    };
    options.device_index = 0;
    EXPECT_EQ(device_of(), first.name);
    options.device_index = -1;
    options.device = "0";
    EXPECT_EQ(device_of(), first.name);
    std::string name = first.name;
    for (char& c : name) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    options.device = name.c_str();
    EXPECT_EQ(device_of(), first.name);
}

TEST(Contexts, RefuseWhatIsNotThere) {
    clba_context_options options = context_options();
    clba_context* context = nullptr;
    EXPECT_TRUE(refused(clba_context_create(&options, nullptr), {"context", "NULL"}));
    options.device = "no such device";
    EXPECT_TRUE(refused(clba_context_create(&options, &context), CLBA_ERROR_NO_DEVICE,
                        {"no such device", "0: "}));
    options.device = nullptr;
    options.device_index = 12345;
    EXPECT_TRUE(
        refused(clba_context_create(&options, &context), CLBA_ERROR_NO_DEVICE, {"12345", "0: "}));
    options.device_index = -2;
    EXPECT_TRUE(refused(clba_context_create(&options, &context), {"device_index", "-2"}));
    options.device_index = -1;
    options.cl_context = &options;
    EXPECT_TRUE(refused(clba_context_create(&options, &context), {"cl_command_queue"}));
    EXPECT_EQ(context, nullptr);
    EXPECT_TRUE(refused(clba_context_retain(nullptr), {"context", "NULL"}));
    EXPECT_TRUE(refused(clba_context_get_device(nullptr, nullptr), {"context", "NULL"}));
    clba_context_release(nullptr);
}

TEST(Contexts, RefuseANamedCacheFolderThatCannotBeWritten) {
    clba_context_options options = context_options();
    options.cache_dir = "/dev/null/kernels";
    clba_context* context = nullptr;
    EXPECT_TRUE(refused(clba_context_create(&options, &context), CLBA_ERROR_FILE,
                        {"/dev/null/kernels", "CLBA_CACHE_DIR"}));
    options.cache_dir = "";
    EXPECT_OK(clba_context_create(&options, &context));
    clba_context_release(context);
}

// struct_size: an older caller's struct is shorter, a newer one's longer with fields that this
// version must know or find at 0.
template <class Options, class Init, class Use>
void test_option_struct(const Init& init, const Use& use) {
    struct Newer {
        Options options;
        double more[2];
    } newer;
    ASSERT_OK(init(&newer.options, sizeof newer));
    EXPECT_EQ(newer.options.struct_size, sizeof newer);
    EXPECT_EQ(newer.more[0], 0);
    EXPECT_OK(use(&newer.options));
    newer.more[1] = 1;
    EXPECT_TRUE(refused(use(&newer.options), {"byte"}));

    Options options;
    std::memset(static_cast<void*>(&options), 0xff, sizeof options);
    ASSERT_OK(init(&options, 8));
    EXPECT_EQ(options.struct_size, 8u);
    EXPECT_EQ(reinterpret_cast<unsigned char*>(&options)[8], 0xff);  // beyond the older struct
    EXPECT_OK(use(&options));  // what it lacks has its default
    options.struct_size = 0;
    EXPECT_TRUE(refused(use(&options), {"struct_size = 0", "_init"}));
    EXPECT_TRUE(refused(init(&options, 0), {"struct_size = 0"}));
    EXPECT_TRUE(refused(init(nullptr, sizeof options), {"NULL"}));
}

TEST(Structs, OptionsOfOtherVersions) {
    const Context context = make_context();
    const Scene scene = generate();
    test_option_struct<clba_context_options>(
        clba_context_options_init, [](const clba_context_options* options) {
            clba_context* made = nullptr;
            const clba_status status = clba_context_create(options, &made);
            clba_context_release(made);
            return status;
        });
    test_option_struct<clba_solver_options>(
        clba_solver_options_init, [&](const clba_solver_options* options) {
            return clba_problem_solve(scene.start.get(), context.get(), options, nullptr);
        });
    test_option_struct<clba_scene_options>(
        clba_scene_options_init, [](const clba_scene_options* options) {
            clba_problem* made = nullptr;
            const clba_status status = clba_problem_generate(options, &made, nullptr);
            clba_problem_release(made);
            return status;
        });
    test_option_struct<clba_evaluation>(clba_evaluation_init, [&](clba_evaluation* evaluation) {
        return clba_problem_evaluate(scene.start.get(), context.get(), evaluation);
    });
}

template <class Info, class Get>
void test_result_struct(const Get& get) {
    struct Newer {
        Info info;
        double more;
    } newer;
    std::memset(static_cast<void*>(&newer), 0xff, sizeof newer);
    newer.info.struct_size = sizeof newer;
    ASSERT_OK(get(&newer.info));
    EXPECT_EQ(newer.info.struct_size, sizeof newer);

    Info info;
    std::memset(static_cast<void*>(&info), 0xff, sizeof info);
    info.struct_size = 8;
    ASSERT_OK(get(&info));
    EXPECT_EQ(info.struct_size, 8u);
    const auto* bytes = reinterpret_cast<unsigned char*>(&info);
    EXPECT_EQ(std::memcmp(bytes + 4, reinterpret_cast<unsigned char*>(&newer) + 4, 4), 0);
    for (size_t i = 8; i < sizeof info; ++i) ASSERT_EQ(bytes[i], 0xff) << i;
    info.struct_size = 0;
    EXPECT_TRUE(refused(get(&info), {"struct_size = 0"}));
    EXPECT_TRUE(refused(get(nullptr), {"NULL"}));
}

TEST(Structs, ResultsForOtherVersions) {
    const Context context = make_context();
    const Scene scene = generate();
    test_result_struct<clba_device_info>(
        [](clba_device_info* info) { return clba_get_device(0, info); });
    test_result_struct<clba_problem_info>(
        [&](clba_problem_info* info) { return clba_problem_get_info(scene.start.get(), info); });
    test_result_struct<clba_comparison>([&](clba_comparison* info) {
        return clba_problem_compare(scene.truth.get(), scene.start.get(), info);
    });
    clba_result* made = nullptr;
    ASSERT_OK(clba_problem_solve(scene.start.get(), context.get(), nullptr, &made));
    const Result result(made);
    test_result_struct<clba_summary>(
        [&](clba_summary* info) { return clba_result_get_summary(made, info); });
    test_result_struct<clba_iteration>(
        [&](clba_iteration* info) { return clba_result_get_row(made, 1, info); });
}

TEST(Arrays, RoundTrip) {
    const Scene scene = generate();
    const Data data = with_other_models(data_of(scene.start));
    const Problem problem = problem_of(data);
    const Data again = data_of(problem);
    // Quaternions are normalised, which may move their last bit.
    EXPECT_EQ(again.models, data.models);
    EXPECT_EQ(again.params, data.params);
    EXPECT_EQ(again.cameras, data.cameras);
    EXPECT_EQ(again.xyz, data.xyz);
    EXPECT_EQ(again.images, data.images);
    EXPECT_EQ(again.points, data.points);
    EXPECT_EQ(again.xy, data.xy);
    for (size_t i = 0; i < data.poses.size(); ++i)
        EXPECT_NEAR(again.poses[i], data.poses[i], 4e-16 * (1 + std::abs(data.poses[i])));
    const clba_problem_info info = info_of(problem);
    EXPECT_EQ(info.num_cameras, data.num_cameras());
    EXPECT_EQ(info.num_shared_cameras, 1);
    EXPECT_EQ(info.num_parameters_per_image_block, 6 + 8);
    EXPECT_EQ(info.num_image_camera_parameters,
              6 * data.num_images() + static_cast<int64_t>(data.params.size()));
    EXPECT_EQ(info.num_parameters, info.num_image_camera_parameters + 3 * data.num_points());
}

TEST(Arrays, Offsets) {
    const Scene scene = generate();
    const Data data = with_other_models(data_of(scene.start));
    const Problem problem = problem_of(data);
    std::vector<int64_t> poses(data.cameras.size()), intrinsics(data.models.size());
    ASSERT_OK(clba_problem_get_offsets(problem.get(), poses.data(), intrinsics.data()));
    // Image 0 owns a radial camera of 5, 1 and 2 share camera 1, 3 and later own snavely ones of 3;
    // then come camera 1 of 8 and camera 2 that nobody uses.
    const int64_t rest = 6 + 5 + 6 + 6;
    EXPECT_EQ(poses[0], 0);
    EXPECT_EQ(intrinsics[0], 6);
    EXPECT_EQ(poses[1], 11);
    EXPECT_EQ(poses[2], 17);
    for (size_t i = 3; i < poses.size(); ++i) {
        EXPECT_EQ(poses[i], rest + 9 * static_cast<int64_t>(i - 3));
        EXPECT_EQ(intrinsics[i], poses[i] + 6);
    }
    EXPECT_EQ(intrinsics[1], rest + 9 * static_cast<int64_t>(poses.size() - 3));
    EXPECT_EQ(intrinsics[2], intrinsics[1] + 8);
    EXPECT_OK(clba_problem_get_offsets(problem.get(), nullptr, nullptr));
    EXPECT_TRUE(refused(clba_problem_get_offsets(nullptr, nullptr, nullptr), {"problem"}));
}

// Rows within arrays of structs: the stride skips what lies between.
TEST(Arrays, Interleaved) {
    const Data data = data_of(generate().start);
    struct Camera {
        double gap[1], params[3];
        int32_t model, more;
    };
    struct Image {
        int32_t camera, id;
        double pose[7], center[3];
    };
    struct Observation {
        int32_t image, point;
        double xy[2];
        char color[4], more[4];
    };
    struct Point {
        char color[8];
        double xyz[3];
    };
    std::vector<Camera> cameras(data.models.size());
    std::vector<Image> images(data.cameras.size());
    std::vector<Point> points(data.xyz.size() / 3);
    std::vector<Observation> observations(data.images.size());
    for (size_t i = 0; i < cameras.size(); ++i) {
        cameras[i].model = data.models[i];
        std::copy_n(&data.params[3 * i], 3, cameras[i].params);
    }
    for (size_t i = 0; i < images.size(); ++i) {
        images[i].camera = data.cameras[i];
        std::copy_n(&data.poses[7 * i], 7, images[i].pose);
    }
    for (size_t i = 0; i < points.size(); ++i) std::copy_n(&data.xyz[3 * i], 3, points[i].xyz);
    for (size_t i = 0; i < observations.size(); ++i)
        observations[i] = {
            data.images[i], data.points[i], {data.xy[2 * i], data.xy[2 * i + 1]}, {}, {}};
    clba_problem* made = nullptr;
    ASSERT_OK(clba_problem_create(&made));
    const Problem problem(made);
    EXPECT_OK(clba_problem_set_cameras(made, data.num_cameras(), &cameras[0].model, sizeof(Camera),
                                       cameras[0].params, sizeof(Camera)));
    EXPECT_OK(clba_problem_set_images(made, data.num_images(), &images[0].camera, sizeof(Image),
                                      images[0].pose, sizeof(Image)));
    EXPECT_OK(clba_problem_set_points(made, data.num_points(), points[0].xyz, sizeof(Point)));
    EXPECT_OK(clba_problem_set_observations(
        made, data.num_observations(), &observations[0].image, sizeof(Observation),
        &observations[0].point, sizeof(Observation), observations[0].xy, sizeof(Observation)));
    EXPECT_EQ(data_of(problem), data_of(problem_of(data)));

    // And back, in part: rows 2 to 4 come to the first three places, and no other byte changes.
    std::vector<Image> some(3);
    std::memset(static_cast<void*>(some.data()), 0x55, 3 * sizeof(Image));
    ASSERT_OK(clba_problem_get_images(made, 2, 3, &some[0].camera, sizeof(Image), some[0].pose,
                                      sizeof(Image)));
    ASSERT_OK(clba_problem_get_centers(made, 2, 3, some[0].center, sizeof(Image)));
    for (size_t i = 0; i < 3; ++i) {
        EXPECT_EQ(some[i].camera, data.cameras[2 + i]);
        EXPECT_EQ(some[i].id, 0x55555555);
        const double* p = some[i].pose;
        EXPECT_NEAR(p[4], data.poses[7 * (2 + i) + 4], 0);
        // R C + t = 0 with R C = C + 2 w (v x C) + 2 v x (v x C).
        const double* c = some[i].center;
        const double ux = 2 * (p[2] * c[2] - p[3] * c[1]), uy = 2 * (p[3] * c[0] - p[1] * c[2]),
                     uz = 2 * (p[1] * c[1] - p[2] * c[0]);
        const double size = 1e-14 * (std::abs(c[0]) + std::abs(c[1]) + std::abs(c[2]));
        EXPECT_NEAR(c[0] + p[0] * ux + p[2] * uz - p[3] * uy, -p[4], size);
        EXPECT_NEAR(c[1] + p[0] * uy + p[3] * ux - p[1] * uz, -p[5], size);
        EXPECT_NEAR(c[2] + p[0] * uz + p[1] * uy - p[2] * ux, -p[6], size);
    }
    std::vector<Camera> two(2);
    ASSERT_OK(clba_problem_get_cameras(made, 1, 2, &two[0].model, sizeof(Camera), two[0].params,
                                       sizeof(Camera)));
    EXPECT_EQ(two[1].params[0], data.params[6]);
    std::vector<Observation> one(1);
    ASSERT_OK(clba_problem_get_observations(made, 5, 1, &one[0].image, 0, &one[0].point, 0,
                                            one[0].xy, 0));
    EXPECT_EQ(one[0].image, data.images[5]);
    EXPECT_EQ(one[0].xy[1], data.xy[11]);
}

class Setters : public testing::Test {
protected:
    Setters() : data(data_of(generate().start)), problem(problem_of(data)), p(problem.get()) {
        before = data_of(problem);
    }
    // Nothing that was refused left a trace.
    ~Setters() override { EXPECT_EQ(data_of(problem), before); }
    Data data;
    Problem problem;
    clba_problem* p;
    Data before;
};

TEST_F(Setters, RefuseNull) {
    const double* d = data.params.data();
    const int32_t* i = data.models.data();
    EXPECT_TRUE(refused(clba_problem_set_cameras(nullptr, 1, i, 0, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_cameras(p, 1, nullptr, 0, d, 0), {"models"}));
    EXPECT_TRUE(refused(clba_problem_set_cameras(p, 1, i, 0, nullptr, 0), {"params"}));
    EXPECT_TRUE(refused(clba_problem_set_images(nullptr, 1, i, 0, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_images(p, 1, nullptr, 0, d, 0), {"camera_indices"}));
    EXPECT_TRUE(refused(clba_problem_set_images(p, 1, i, 0, nullptr, 0), {"poses"}));
    EXPECT_TRUE(refused(clba_problem_set_points(nullptr, 1, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_points(p, 1, nullptr, 0), {"xyz"}));
    EXPECT_TRUE(refused(clba_problem_set_observations(nullptr, 1, i, 0, i, 0, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_observations(p, 1, nullptr, 0, i, 0, d, 0), {"images"}));
    EXPECT_TRUE(refused(clba_problem_set_observations(p, 1, i, 0, nullptr, 0, d, 0), {"points"}));
    EXPECT_TRUE(refused(clba_problem_set_observations(p, 1, i, 0, i, 0, nullptr, 0), {"xy"}));
    const int64_t n = data.num_observations();
    EXPECT_TRUE(refused(clba_problem_set_covariances(nullptr, n, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_covariances(p, n, nullptr, 0), {"covariances"}));
    EXPECT_TRUE(refused(clba_problem_set_sigmas(nullptr, n, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_sigmas(p, n, nullptr, 0), {"sigmas"}));
    const int32_t images = data.num_images(), cameras = data.num_cameras(),
                  points = data.num_points();
    EXPECT_TRUE(refused(clba_problem_set_constant_images(nullptr, images, i, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_images(p, images, nullptr, 0), {"flags"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_cameras(nullptr, cameras, i, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_cameras(p, cameras, nullptr, 0), {"flags"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_points(nullptr, points, i, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_points(p, points, nullptr, 0), {"flags"}));
    EXPECT_TRUE(refused(clba_problem_set_image_uncertainties(nullptr, images, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_image_uncertainties(p, images, nullptr, 0), {"values"}));
    EXPECT_TRUE(
        refused(clba_problem_set_camera_uncertainties(nullptr, cameras, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_camera_uncertainties(p, cameras, nullptr, 0), {"values"}));
    EXPECT_TRUE(refused(clba_problem_set_point_uncertainties(nullptr, points, d, 0), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_set_point_uncertainties(p, points, nullptr, 0), {"values"}));
    EXPECT_TRUE(refused(clba_problem_set_loss(nullptr, CLBA_LOSS_NONE, 1), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_apply_step(nullptr, d), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_apply_step(p, nullptr), {"step"}));
    EXPECT_TRUE(refused(clba_problem_get_info(nullptr, nullptr), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_retain(nullptr), {"problem"}));
    clba_problem_release(nullptr);
}

TEST_F(Setters, RefuseWrongCountsAndStrides) {
    const double* d = data.xyz.data();
    const int32_t* i = data.images.data();
    EXPECT_TRUE(refused(clba_problem_set_cameras(p, -1, i, 0, d, 0), {"count = -1"}));
    EXPECT_TRUE(refused(clba_problem_set_images(p, -1, i, 0, d, 0), {"count = -1"}));
    EXPECT_TRUE(refused(clba_problem_set_points(p, -1, d, 0), {"count = -1"}));
    EXPECT_TRUE(refused(clba_problem_set_observations(p, -1, i, 0, i, 0, d, 0), {"count = -1"}));
    EXPECT_TRUE(refused(clba_problem_set_covariances(p, 3, d, 0), {"count = 3", "observations"}));
    EXPECT_TRUE(refused(clba_problem_set_sigmas(p, -1, d, 0), {"count = -1"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_images(p, 3, i, 0), {"count = 3", "images"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_cameras(p, 3, i, 0), {"count = 3", "cameras"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_points(p, 3, i, 0), {"count = 3", "points"}));
    EXPECT_TRUE(refused(clba_problem_set_image_uncertainties(p, 3, d, 0), {"count = 3", "images"}));
    EXPECT_TRUE(
        refused(clba_problem_set_camera_uncertainties(p, 3, d, 0), {"count = 3", "cameras"}));
    EXPECT_TRUE(
        refused(clba_problem_set_point_uncertainties(p, -1, d, 0), {"count = -1", "points"}));
    EXPECT_TRUE(refused(clba_problem_set_points(p, 1, d, 16), {"stride of 16", "24"}));
    EXPECT_TRUE(refused(clba_problem_set_images(p, 1, i, 4, d, 8), {"stride of 8", "56"}));
    EXPECT_TRUE(refused(clba_problem_set_images(p, 1, i, 2, d, 0), {"stride of 2", "4"}));
    EXPECT_TRUE(
        refused(clba_problem_set_cameras(p, 1, data.models.data(), 0, d, 8), {"stride of 8"}));
    EXPECT_TRUE(refused(clba_problem_set_observations(p, 1, i, 0, i, 0, d, 8), {"stride of 8"}));
}

TEST_F(Setters, NameTheRowThatIsWrong) {
    const auto with = [](auto values, size_t at, auto value) {
        values[at] = value;
        return values;
    };
    for (double bad : {nan, infinity, -infinity}) {
        EXPECT_TRUE(refused(clba_problem_set_cameras(p, data.num_cameras(), data.models.data(), 0,
                                                     with(data.params, 7, bad).data(), 0),
                            {"params[2][1]", "finite"}));
        EXPECT_TRUE(refused(clba_problem_set_images(p, data.num_images(), data.cameras.data(), 0,
                                                    with(data.poses, 19, bad).data(), 0),
                            {"poses[2][5]", "finite"}));
        EXPECT_TRUE(
            refused(clba_problem_set_points(p, data.num_points(), with(data.xyz, 5, bad).data(), 0),
                    {"xyz[1][2]", "finite"}));
        EXPECT_TRUE(refused(
            clba_problem_set_observations(p, data.num_observations(), data.images.data(), 0,
                                          data.points.data(), 0, with(data.xy, 9, bad).data(), 0),
            {"xy[4]", "finite"}));
        const std::vector<double> ones(static_cast<size_t>(std::max<int64_t>(
                                           3 * data.num_observations(), 6 * data.num_images())),
                                       1.0);
        EXPECT_TRUE(refused(
            clba_problem_set_sigmas(p, data.num_observations(), with(ones, 3, bad).data(), 0),
            {"sigmas[3]", "> 0"}));
        EXPECT_TRUE(refused(clba_problem_set_image_uncertainties(p, data.num_images(),
                                                                 with(ones, 8, bad).data(), 0),
                            {"values[1][2]", "> 0"}));
        EXPECT_TRUE(refused(clba_problem_set_camera_uncertainties(p, data.num_cameras(),
                                                                  with(ones, 4, bad).data(), 0),
                            {"values[1][1]", "> 0"}));
        EXPECT_TRUE(refused(clba_problem_set_point_uncertainties(p, data.num_points(),
                                                                 with(ones, 4, bad).data(), 0),
                            {"values[1][1]", "> 0"}));
        EXPECT_TRUE(refused(clba_problem_set_loss(p, CLBA_LOSS_HUBER, bad), {"scale"}));
        std::vector<double> step(static_cast<size_t>(info_of(problem).num_parameters));
        EXPECT_TRUE(refused(clba_problem_apply_step(p, with(step, 11, bad).data()),
                            {"step[11]", "finite"}));
    }
    for (int32_t bad : {-1, clba_num_camera_models(), 1000})
        EXPECT_TRUE(refused(
            clba_problem_set_cameras(p, data.num_cameras(), with(data.models, 3, bad).data(), 0,
                                     data.params.data(), 0),
            {"models[3]", "0 to 12"}));
    for (int32_t bad : {-1, data.num_cameras()})
        EXPECT_TRUE(
            refused(clba_problem_set_images(p, data.num_images(), with(data.cameras, 3, bad).data(),
                                            0, data.poses.data(), 0),
                    {"camera_indices[3]", "num_cameras"}));
    for (int32_t bad : {-1, data.num_images()})
        EXPECT_TRUE(refused(clba_problem_set_observations(p, data.num_observations(),
                                                          with(data.images, 3, bad).data(), 0,
                                                          data.points.data(), 0, data.xy.data(), 0),
                            {"images[3]", "num_images"}));
    for (int32_t bad : {-1, data.num_points()})
        EXPECT_TRUE(refused(
            clba_problem_set_observations(p, data.num_observations(), data.images.data(), 0,
                                          with(data.points, 3, bad).data(), 0, data.xy.data(), 0),
            {"points[3]", "num_points"}));
    Data no_rotation = data;
    std::fill_n(no_rotation.poses.begin() + 7, 4, 0.0);
    EXPECT_TRUE(refused(clba_problem_set_images(p, data.num_images(), data.cameras.data(), 0,
                                                no_rotation.poses.data(), 0),
                        {"poses[1]", "quaternion"}));
    EXPECT_TRUE(refused(
        clba_problem_set_constant_images(p, data.num_images(), with(data.cameras, 0, 4).data(), 0),
        {"flags[0] = 4"}));
    EXPECT_TRUE(refused(clba_problem_set_constant_cameras(p, data.num_cameras(),
                                                          std::vector<int32_t>(8, 8).data(), 0),
                        {"flags[0] = 8", "3 parameters"}));
    for (int32_t bad : {-1, 5})
        EXPECT_TRUE(refused(clba_problem_set_loss(p, bad, 1), {"loss", "0 to 4"}));
    for (double bad : {0.0, -1.0})
        EXPECT_TRUE(refused(clba_problem_set_loss(p, CLBA_LOSS_CAUCHY, bad), {"scale"}));
    EXPECT_OK(clba_problem_set_loss(p, CLBA_LOSS_NONE, nan));  // ignored
    const std::array<std::array<double, 3>, 5> indefinite{
        {{-1, 0, 1}, {1, 2, 1}, {1, 1, 1}, {1, nan, 1}, {infinity, 0, 1}}};
    for (const auto& covariance : indefinite) {
        std::vector<double> covariances(3 * data.images.size(), 0.0);
        for (size_t i = 0; i < covariances.size(); ++i) covariances[i] = i % 3 == 1 ? 0 : 1;
        std::copy(covariance.begin(), covariance.end(), covariances.begin() + 6);
        EXPECT_TRUE(
            refused(clba_problem_set_covariances(p, data.num_observations(), covariances.data(), 0),
                    {"covariances[2]", "positive definite"}));
    }
}

TEST_F(Setters, GettersRefuseRowsThatAreNotThere) {
    std::vector<double> d(1000);
    std::vector<int32_t> i(1000);
    EXPECT_TRUE(refused(clba_problem_get_cameras(p, -1, 1, i.data(), 0, nullptr, 0), {"cameras"}));
    EXPECT_TRUE(refused(clba_problem_get_images(p, 8, 1, i.data(), 0, nullptr, 0), {"images"}));
    EXPECT_TRUE(refused(clba_problem_get_centers(p, 7, 2, d.data(), 0), {"images"}));
    EXPECT_TRUE(refused(clba_problem_get_points(p, 0, -1, d.data(), 0), {"points"}));
    EXPECT_TRUE(refused(clba_problem_get_constant_images(p, 8, 1, i.data(), 0), {"images"}));
    EXPECT_TRUE(refused(clba_problem_get_constant_cameras(p, 9, 1, i.data(), 0), {"cameras"}));
    EXPECT_TRUE(refused(clba_problem_get_constant_points(p, 0, 1, nullptr, 0), {"flags", "NULL"}));
    i.assign(8, -1);
    EXPECT_OK(clba_problem_get_constant_images(p, 0, 8, i.data(), 0));
    EXPECT_EQ(i[0] | i[7], 0);
    i.resize(1000);
    EXPECT_TRUE(
        refused(clba_problem_get_points(p, std::numeric_limits<int32_t>::max(), 1, d.data(), 0),
                {"points"}));
    EXPECT_TRUE(refused(clba_problem_get_observations(p, std::numeric_limits<int64_t>::max(), 1,
                                                      i.data(), 0, nullptr, 0, nullptr, 0),
                        {"observations"}));
    EXPECT_TRUE(refused(clba_problem_get_points(p, 0, 1, nullptr, 0), {"xyz", "NULL"}));
    EXPECT_TRUE(refused(clba_problem_get_centers(p, 0, 1, nullptr, 0), {"centers", "NULL"}));
    EXPECT_TRUE(refused(clba_problem_get_points(p, 0, 1, d.data(), 8), {"stride of 8"}));
    EXPECT_TRUE(refused(clba_problem_get_points(nullptr, 0, 1, d.data(), 0), {"problem"}));
    EXPECT_OK(clba_problem_get_points(p, data.num_points(), 0, nullptr, 0));
}

TEST(Replacing, KeepsOrDropsWhatDependsOnIt) {
    const Data data = data_of(generate().start);
    const Problem problem = problem_of(data);
    clba_problem* p = problem.get();
    const auto observations = [&] { return info_of(problem).num_observations; };
    ASSERT_OK(clba_problem_set_points(p, data.num_points(), data.xyz.data(), 0));
    ASSERT_OK(clba_problem_set_images(p, data.num_images(), data.cameras.data(), 0,
                                      data.poses.data(), 0));
    ASSERT_OK(clba_problem_set_cameras(p, data.num_cameras(), data.models.data(), 0,
                                       data.params.data(), 0));
    EXPECT_EQ(observations(), data.num_observations());
    EXPECT_TRUE(refused(clba_problem_set_cameras(p, data.num_cameras() - 1, data.models.data(), 0,
                                                 data.params.data(), 0),
                        {"images[7].camera = 7"}));
    EXPECT_EQ(observations(), data.num_observations());
    ASSERT_OK(clba_problem_set_points(p, data.num_points() - 1, data.xyz.data(), 0));
    EXPECT_EQ(observations(), 0);

    const Problem other = problem_of(data);
    ASSERT_OK(clba_problem_set_images(other.get(), data.num_images() - 1, data.cameras.data(), 0,
                                      data.poses.data(), 0));
    EXPECT_EQ(info_of(other).num_observations, 0);
    ASSERT_OK(clba_problem_set_cameras(other.get(), data.num_cameras() - 1, data.models.data(), 0,
                                       data.params.data(), 0));
    ASSERT_OK(clba_problem_set_images(other.get(), 0, nullptr, 0, nullptr, 0));
    ASSERT_OK(clba_problem_set_cameras(other.get(), 0, nullptr, 0, nullptr, 0));
    ASSERT_OK(clba_problem_set_points(other.get(), 0, nullptr, 0));
    EXPECT_EQ(info_of(other).num_parameters, 0);
}

TEST(Handles, CountReferences) {
    clba_problem* problem = nullptr;
    ASSERT_OK(clba_problem_create(&problem));
    ASSERT_OK(clba_problem_retain(problem));
    clba_problem_release(problem);
    EXPECT_OK(clba_problem_set_points(problem, 0, nullptr, 0));
    clba_problem_release(problem);
    const Context context = make_context();
    ASSERT_OK(clba_context_retain(context.get()));
    clba_context_release(context.get());
}

TEST(Comparing, MeasuresAfterAlignment) {
    const Scene scene = generate();
    // b = the truth in a world that is twice as large, turned and moved: nothing is left.
    Data moved = data_of(scene.truth);
    // X' = 2 Q X + m with Q half a turn about z; t' = 2 t - R' m.
    const std::array<double, 3> m{5, -3, 1};
    for (size_t i = 0; i < moved.xyz.size(); i += 3) {
        moved.xyz[i] = -2 * moved.xyz[i] + m[0];
        moved.xyz[i + 1] = -2 * moved.xyz[i + 1] + m[1];
        moved.xyz[i + 2] = 2 * moved.xyz[i + 2] + m[2];
    }
    for (size_t i = 0; i < moved.poses.size(); i += 7) {
        double* p = moved.poses.data() + i;
        // R' = R Q^T: q (0, 0, 0, -1).
        const std::array<double, 4> q{p[3], -p[2], p[1], -p[0]};
        std::copy(q.begin(), q.end(), p);
        const double ux = 2 * (q[2] * m[2] - q[3] * m[1]), uy = 2 * (q[3] * m[0] - q[1] * m[2]),
                     uz = 2 * (q[1] * m[1] - q[2] * m[0]);
        p[4] = 2 * p[4] - (m[0] + q[0] * ux + q[2] * uz - q[3] * uy);
        p[5] = 2 * p[5] - (m[1] + q[0] * uy + q[3] * ux - q[1] * uz);
        p[6] = 2 * p[6] - (m[2] + q[0] * uz + q[1] * uy - q[2] * ux);
    }
    const Problem b = problem_of(moved);
    clba_comparison comparison;
    comparison.struct_size = sizeof comparison;
    ASSERT_OK(clba_problem_compare(scene.truth.get(), b.get(), &comparison));
    EXPECT_NEAR(comparison.scale, 0.5, 1e-12);
    EXPECT_GT(comparison.extent, 0);
    EXPECT_LT(comparison.max_center_distance, 1e-12 * comparison.extent);
    EXPECT_LT(comparison.max_point_distance, 1e-11 * comparison.extent);
    ASSERT_OK(clba_problem_compare(scene.truth.get(), scene.start.get(), &comparison));
    EXPECT_GT(comparison.median_center_distance, 1e-4 * comparison.extent);
    EXPECT_LE(comparison.median_center_distance, comparison.max_center_distance);
    EXPECT_LE(comparison.median_point_distance, comparison.max_point_distance);

    const Scene other = generate(0, 9);
    EXPECT_TRUE(
        refused(clba_problem_compare(scene.truth.get(), other.truth.get(), &comparison), {"9"}));
    EXPECT_TRUE(refused(clba_problem_compare(nullptr, b.get(), &comparison), {"a is NULL"}));
    EXPECT_TRUE(refused(clba_problem_compare(b.get(), nullptr, &comparison), {"b is NULL"}));
}

class Files : public testing::Test {
protected:
    Files() {
        static int counter = 0;
        folder_ = std::filesystem::path(testing::TempDir()) /
                  ("clba_api_test_" + std::to_string(::getpid()) + '_' + std::to_string(counter++));
        std::filesystem::create_directory(folder_);
    }
    ~Files() override { std::filesystem::remove_all(folder_); }
    std::string path(const char* name) const { return (folder_ / name).string(); }
    std::string file(const char* name, const char* text) const {
        std::FILE* stream = std::fopen(path(name).c_str(), "wb");
        std::fputs(text, stream);
        std::fclose(stream);
        return path(name);
    }

private:
    std::filesystem::path folder_;
};

TEST_F(Files, BalRoundTrip) {
    const Scene scene = generate();
    for (const char* name : {"scene.txt", "scene.txt.gz", "scene.txt.bz2"}) {
        ASSERT_OK(clba_problem_write_bal(scene.start.get(), path(name).c_str()));
        clba_problem* read = nullptr;
        ASSERT_OK(clba_problem_read_bal(path(name).c_str(), &read));
        const Data again = data_of(Problem(read)), data = data_of(scene.start);
        EXPECT_EQ(again.xyz, data.xyz);
        EXPECT_EQ(again.xy, data.xy);
        EXPECT_EQ(again.params, data.params);
        EXPECT_EQ(again.points, data.points);
        // Rotations go through rotation vectors.
        for (size_t i = 0; i < data.poses.size(); i += 7) {
            const double sign = data.poses[i] * again.poses[i] < 0 ? -1 : 1;
            for (size_t k = 0; k < 7; ++k)
                EXPECT_NEAR(again.poses[i + k], (k < 4 ? sign : 1) * data.poses[i + k], 1e-15 * 8);
        }
    }
    ASSERT_OK(clba_problem_write_ply(scene.start.get(), path("scene.ply").c_str()));
    EXPECT_GT(std::filesystem::file_size(path("scene.ply")), 15u * 100);
}

TEST_F(Files, Errors) {
    const Scene scene = generate();
    clba_problem* read = nullptr;
    EXPECT_TRUE(refused(clba_problem_read_bal(nullptr, &read), {"path"}));
    EXPECT_TRUE(refused(clba_problem_read_bal("x", nullptr), {"problem"}));
    EXPECT_TRUE(
        refused(clba_problem_read_bal(path("absent").c_str(), &read), CLBA_ERROR_FILE, {"absent"}));
    EXPECT_TRUE(refused(clba_problem_read_bal(path("").c_str(), &read), CLBA_ERROR_FILE, {}));
    EXPECT_TRUE(refused(clba_problem_read_bal(file("bad", "1 1 1\n0 0 x").c_str(), &read),
                        CLBA_ERROR_FORMAT, {"bad"}));
    EXPECT_TRUE(refused(clba_problem_read_bal(file("empty", "").c_str(), &read), CLBA_ERROR_FORMAT,
                        {"empty"}));
    EXPECT_EQ(read, nullptr);
    EXPECT_TRUE(refused(clba_problem_write_bal(nullptr, "x"), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_write_bal(scene.start.get(), nullptr), {"path"}));
    EXPECT_TRUE(refused(clba_problem_write_ply(nullptr, "x"), {"problem"}));
    EXPECT_TRUE(refused(clba_problem_write_ply(scene.start.get(), nullptr), {"path"}));
    for (const auto write : {clba_problem_write_bal, clba_problem_write_ply})
        EXPECT_TRUE(refused(write(scene.start.get(), path("absent/out").c_str()), CLBA_ERROR_FILE,
                            {"absent/out"}));
    const Problem other = problem_of(with_other_models(data_of(scene.start)));
    EXPECT_TRUE(refused(clba_problem_write_bal(other.get(), path("out").c_str()), {"snavely"}));
    EXPECT_FALSE(std::filesystem::exists(path("out")));
    EXPECT_OK(clba_problem_write_ply(other.get(), path("out").c_str()));
}

TEST_F(Files, AnyFormat) {
    const Scene scene = generate();
    const clba_problem* start = scene.start.get();
    EXPECT_EQ(clba_problem_get_format(start), CLBA_FORMAT_AUTO);
    EXPECT_STREQ(clba_problem_notices(start), "");
    EXPECT_STREQ(clba_problem_get_image_name(start, 0), "");
    EXPECT_STREQ(clba_format_name(CLBA_FORMAT_AUTO), "auto");
    EXPECT_STREQ(clba_format_name(CLBA_FORMAT_COLMAP_TEXT), "colmap_text");
    EXPECT_EQ(clba_format_name(-1), nullptr);
    EXPECT_EQ(clba_format_name(CLBA_FORMAT_PLY + 1), nullptr);

    clba_write_options write;
    ASSERT_OK(clba_write_options_init(&write, sizeof write));
    write.format = CLBA_FORMAT_COLMAP_BINARY;
    ASSERT_OK(clba_problem_write(start, path("model").c_str(), &write));
    std::vector<double> fractions;
    clba_read_options options;
    ASSERT_OK(clba_read_options_init(&options, sizeof options));
    options.user_data = &fractions;
    options.on_progress = [](double fraction, void* user_data) -> int32_t {
        static_cast<std::vector<double>*>(user_data)->push_back(fraction);
        return 0;
    };
    clba_problem* read = nullptr;
    ASSERT_OK(clba_problem_read(path("model").c_str(), &options, &read));
    const Problem problem(read);
    EXPECT_EQ(clba_problem_get_format(read), CLBA_FORMAT_COLMAP_BINARY);
    ASSERT_FALSE(fractions.empty());
    EXPECT_TRUE(std::is_sorted(fractions.begin(), fractions.end()));
    EXPECT_STREQ(clba_problem_get_image_name(read, 1), "image000002");
    EXPECT_EQ(clba_problem_get_image_name(read, 8), nullptr);
    EXPECT_EQ(clba_problem_get_image_name(nullptr, 0), nullptr);

    std::vector<uint64_t> ids(2), sizes(4);
    std::vector<uint8_t> colors(6);
    ASSERT_OK(clba_problem_get_camera_info(read, 3, 2, ids.data(), 0, sizes.data(), 0));
    EXPECT_EQ(ids, (std::vector<uint64_t>{4, 5}));
    EXPECT_GT(sizes[3], 100u);
    ASSERT_OK(clba_problem_get_image_ids(read, 6, 2, ids.data(), 0));
    EXPECT_EQ(ids, (std::vector<uint64_t>{7, 8}));
    ASSERT_OK(clba_problem_get_point_info(read, 1, 2, ids.data(), 0, colors.data(), 0));
    EXPECT_EQ(ids, (std::vector<uint64_t>{2, 3}));
    EXPECT_EQ(colors, std::vector<uint8_t>(6, 255));
    EXPECT_TRUE(refused(clba_problem_get_image_ids(read, 7, 2, ids.data(), 0), {"7", "8 images"}));

    // Rows that are set again in the same number keep their names, in another they do not.
    Data data = data_of(problem);
    ASSERT_OK(clba_problem_set_images(read, 8, data.cameras.data(), 0, data.poses.data(), 0));
    EXPECT_STREQ(clba_problem_get_image_name(read, 1), "image000002");
    ASSERT_OK(clba_problem_set_images(read, 7, data.cameras.data(), 0, data.poses.data(), 0));
    EXPECT_STREQ(clba_problem_get_image_name(read, 1), "");
}

TEST_F(Files, WhatAFormatCannotHoldIsRefused) {
    const Scene scene = generate();
    clba_write_options write;
    ASSERT_OK(clba_write_options_init(&write, sizeof write));
    ASSERT_OK(clba_problem_write(scene.start.get(), path("model/").c_str(), nullptr));
    clba_problem* read = nullptr;
    ASSERT_OK(clba_problem_read(path("model").c_str(), nullptr, &read));
    const Problem problem(read);
    for (const auto call : {clba_problem_write, clba_problem_check_write}) {
        EXPECT_TRUE(refused(call(read, path("out.txt").c_str(), nullptr),
                            {"out.txt", "principal points of 8 cameras", "names", "accept_loss"}));
        EXPECT_TRUE(refused(call(nullptr, "x", nullptr), {"problem"}));
        EXPECT_TRUE(refused(call(read, nullptr, nullptr), {"path"}));
        write.format = 99;
        EXPECT_TRUE(refused(call(read, "x", &write), {"format = 99", "1 (bal)"}));
        write.format = CLBA_FORMAT_BAL;
        write.accept_loss = 2;
        EXPECT_TRUE(refused(call(read, "x", &write), {"accept_loss = 2"}));
        write.accept_loss = 1;
        EXPECT_TRUE(refused(call(read, path("model").c_str(), &write), CLBA_ERROR_FILE,
                            {"model", "folder"}));
    }
    EXPECT_FALSE(std::filesystem::exists(path("out.txt")));
    EXPECT_OK(clba_problem_check_write(read, path("out.txt").c_str(), &write));
    EXPECT_FALSE(std::filesystem::exists(path("out.txt")));
    ASSERT_OK(clba_problem_write(read, path("out.txt").c_str(), &write));
    const Problem other = problem_of(with_other_models(data_of(scene.start)));
    EXPECT_TRUE(refused(clba_problem_write(other.get(), path("out.bal").c_str(), &write),
                        {"cameras[", "snavely"}));
    EXPECT_TRUE(refused(clba_problem_write(other.get(), path("out").c_str(), nullptr),
                        {"out", "name the format"}));

    clba_read_options options;
    ASSERT_OK(clba_read_options_init(&options, sizeof options));
    options.on_progress = [](double, void*) -> int32_t { return 1; };
    clba_problem* cancelled = nullptr;
    EXPECT_TRUE(refused(clba_problem_read(path("out.txt").c_str(), &options, &cancelled),
                        CLBA_ERROR_CANCELLED, {"progress"}));
    options.on_progress = nullptr;
    options.format = CLBA_FORMAT_PLY;
    EXPECT_TRUE(refused(clba_problem_read(path("out.txt").c_str(), &options, &cancelled),
                        {"ply", "only written"}));
    EXPECT_TRUE(refused(clba_problem_read(nullptr, &options, &cancelled), {"path"}));
    EXPECT_TRUE(refused(clba_problem_read("x", nullptr, nullptr), {"problem"}));
    EXPECT_EQ(cancelled, nullptr);
}

TEST(Generating, EqualOptionsGiveEqualScenes) {
    const Scene a = generate(0.1), b = generate(0.1), c = generate(0.1, 8, 60, 2);
    EXPECT_EQ(data_of(a.start), data_of(b.start));
    EXPECT_EQ(data_of(a.truth), data_of(b.truth));
    EXPECT_FALSE(data_of(a.start) == data_of(c.start));
    const Data start = data_of(a.start), truth = data_of(a.truth);
    EXPECT_EQ(start.xy, truth.xy);
    EXPECT_EQ(start.images, truth.images);
    EXPECT_NE(start.xyz, truth.xyz);
}

TEST(Generating, RefusesWhatMakesNoScene) {
    clba_scene_options defaults;
    ASSERT_OK(clba_scene_options_init(&defaults, sizeof defaults));
    EXPECT_EQ(defaults.scene, CLBA_SCENE_HALL);
    EXPECT_EQ(defaults.num_images, 356);
    const auto refuses = [&](auto clba_scene_options::*field, auto value, const char* name) {
        clba_scene_options options = defaults;
        options.*field = value;
        clba_problem *start = nullptr, *truth = nullptr;
        EXPECT_TRUE(refused(clba_problem_generate(&options, &start, &truth), {name}));
        EXPECT_EQ(start, nullptr);
        EXPECT_EQ(truth, nullptr);
    };
    refuses(&clba_scene_options::scene, 0, "scene = 0");
    refuses(&clba_scene_options::scene, 4, "scene = 4");
    refuses(&clba_scene_options::num_images, 1, "num_images");
    refuses(&clba_scene_options::num_points, -1, "num_points");
    refuses(&clba_scene_options::observations_per_image, 7, "observations_per_image");
    for (double bad : {-1.0, nan, infinity}) {
        refuses(&clba_scene_options::pixel_noise, bad, "pixel_noise");
        refuses(&clba_scene_options::outlier_share, bad, "outlier_share");
        refuses(&clba_scene_options::rotation_noise, bad, "rotation_noise");
        refuses(&clba_scene_options::position_noise, bad, "position_noise");
        refuses(&clba_scene_options::point_noise, bad, "point_noise");
    }
    refuses(&clba_scene_options::outlier_share, 1.5, "outlier_share");
    EXPECT_TRUE(refused(clba_problem_generate(&defaults, nullptr, nullptr), {"start"}));
}

}  // namespace
}  // namespace clba_test
