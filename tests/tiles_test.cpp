// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>
#include <set>
#include <vector>

#include "base/error.hpp"
#include "problem/visibility_tiles.hpp"
#include "test_problems.hpp"

namespace clba {
namespace {

// Structure alone: no poses, pixels or parameters.
Problem structure(const std::vector<int32_t>& model_of_camera,
                  const std::vector<int32_t>& camera_of_image, int num_points) {
    Problem problem;
    for (int32_t model : model_of_camera) problem.cameras.emplace_back().model = model;
    for (int32_t camera : camera_of_image) problem.images.emplace_back().camera = camera;
    problem.points.resize(static_cast<size_t>(num_points));
    return problem;
}

Problem random_structure(std::mt19937_64& random) {
    const auto below = [&](size_t bound) { return static_cast<int32_t>(random() % bound); };
    std::vector<int32_t> models(1 + random() % 5), cameras(1 + random() % 12);
    for (int32_t& model : models) model = below(num_camera_models);
    for (int32_t& camera : cameras) camera = below(models.size());
    Problem problem = structure(models, cameras, 1 + below(120));
    // Pairs are drawn with replacement, so that some repeat; a third of the problems repeat many.
    const size_t num_images = random() % 3 ? problem.images.size() : 1;
    for (size_t n = random() % 900; n > 0; --n)
        problem.observations.push_back({below(num_images), below(problem.points.size()), 0.0, 0.0});
    return problem;
}

void expect_points_in_tiles(const Problem& problem, const TileOptions& options,
                            const VisibilityTiles& tiles) {
    std::vector<int> num_slots(problem.points.size(), 0);
    for (const Chunk& chunk : tiles.chunks) {
        ASSERT_GT(chunk.num_tiles(), 0);
        ASSERT_EQ(chunk.tile_num_points.size(), chunk.tile_points.size());
        ASSERT_EQ(chunk.slot_point.size(), static_cast<size_t>(chunk.num_point_slots));
        ASSERT_EQ(chunk.tile_points.front(), 0);
        for (int32_t tile = 0; tile < chunk.num_tiles(); ++tile) {
            const int32_t begin = chunk.tile_points[tile];
            const int32_t end =
                tile + 1 < chunk.num_tiles() ? chunk.tile_points[tile + 1] : chunk.num_point_slots;
            const int32_t num_points = chunk.tile_num_points[tile];
            EXPECT_GE(num_points, 1);
            EXPECT_LE(num_points, options.points_per_tile > 0 ? options.points_per_tile
                                                              : options.max_points_per_tile);
            EXPECT_EQ(begin % options.lanes, 0);
            EXPECT_GE(end - begin - num_points, options.lanes) << "spare slots";
            for (int32_t slot = begin; slot < end; ++slot) {
                if (slot - begin >= num_points)
                    EXPECT_EQ(chunk.slot_point[slot], -1);
                else
                    ++num_slots[static_cast<size_t>(chunk.slot_point[slot])];
            }
        }
    }
    EXPECT_EQ(num_slots, std::vector<int>(problem.points.size(), 1));
}

// Counts the segment's observations in num_visits.
void expect_runs(const Problem& problem, const TileOptions& options, const Chunk& chunk,
                 const Segment& segment, std::vector<int>& num_visits) {
    ASSERT_EQ(segment.tile_runs.size(), static_cast<size_t>(chunk.num_tiles()) + 1);
    ASSERT_EQ(segment.tile_runs.front(), 0);
    ASSERT_EQ(segment.tile_runs.back(), segment.num_runs());
    ASSERT_EQ(segment.run_slots.size(), static_cast<size_t>(segment.num_runs()) + 1);
    ASSERT_EQ(segment.run_slots.front(), 0);
    ASSERT_EQ(segment.slot_point.size(), static_cast<size_t>(segment.num_slots()));
    ASSERT_EQ(segment.slot_observation.size(), static_cast<size_t>(segment.num_slots()));
    for (int32_t tile = 0; tile < chunk.num_tiles(); ++tile) {
        const int32_t first_point = chunk.tile_points[tile];
        const int32_t end_point =
            tile + 1 < chunk.num_tiles() ? chunk.tile_points[tile + 1] : chunk.num_point_slots;
        ASSERT_LE(segment.tile_runs[tile], segment.tile_runs[tile + 1]);
        for (int32_t run = segment.tile_runs[tile]; run < segment.tile_runs[tile + 1]; ++run) {
            SCOPED_TRACE(testing::Message() << "tile " << tile << " run " << run);
            const int32_t image = segment.run_image[run];
            EXPECT_EQ(problem.cameras[problem.images[image].camera].model, segment.model);
            const int32_t begin = segment.run_slots[run], end = segment.run_slots[run + 1];
            EXPECT_EQ(begin % options.lanes, 0);
            EXPECT_EQ(end % options.lanes, 0);
            std::set<uint16_t> points;
            int32_t num_padding = 0;
            for (int32_t slot = begin; slot < end; ++slot) {
                const uint16_t point = segment.slot_point[slot];
                EXPECT_TRUE(points.insert(point).second) << "point slot " << point << " twice";
                ASSERT_LT(first_point + point, end_point);
                const int64_t row = segment.slot_observation[slot];
                if (row < 0) {
                    EXPECT_GE(point, chunk.tile_num_points[tile]);
                    ++num_padding;
                    continue;
                }
                EXPECT_EQ(num_padding, 0) << "padding before an observation";
                ++num_visits[static_cast<size_t>(row)];
                EXPECT_EQ(problem.observations[row].image, image);
                EXPECT_EQ(problem.observations[row].point, chunk.slot_point[first_point + point]);
            }
            EXPECT_LT(num_padding, options.lanes);
            EXPECT_LT(num_padding, end - begin) << "no observations";
        }
    }
}

void expect_block_runs(const Problem& problem, const ParameterLayout& layout,
                       const Segment& segment) {
    ASSERT_EQ(segment.block_runs.size(), segment.block.size() + 1);
    ASSERT_EQ(segment.block_column.size(), segment.block.size());
    ASSERT_EQ(segment.block_runs.front(), 0);
    ASSERT_EQ(segment.block_runs.back(), static_cast<int32_t>(segment.runs.size()));
    std::vector<std::vector<int32_t>> listed(layout.blocks.size());
    for (size_t k = 0; k < segment.block.size(); ++k) {
        const int32_t block = segment.block[k];
        EXPECT_LT(segment.block_runs[k], segment.block_runs[k + 1]) << "block without runs";
        EXPECT_TRUE(listed[block].empty()) << "block " << block << " is listed twice";
        EXPECT_EQ(segment.block_column[k], layout.blocks[block].image < 0 ? num_pose_params : 0);
        listed[block].assign(segment.runs.begin() + segment.block_runs[k],
                             segment.runs.begin() + segment.block_runs[k + 1]);
    }
    for (size_t b = 0; b < layout.blocks.size(); ++b) {
        const ParameterBlock& block = layout.blocks[b];
        std::vector<int32_t> wanted;
        for (int32_t run = 0; run < segment.num_runs(); ++run) {
            const int32_t image = segment.run_image[run];
            if (block.image >= 0 ? block.image == image
                                 : block.camera == problem.images[image].camera)
                wanted.push_back(run);
        }
        EXPECT_EQ(listed[b], wanted) << "block " << b;
    }
}

// What the device keeps for each slot, run and point slot of a chunk.
void expect_buffers_fit(const TileOptions& options, const Chunk& chunk) {
    const auto v_bytes = static_cast<uint64_t>(chunk.num_point_slots) * 6 * sizeof(double);
    EXPECT_LE(v_bytes, options.max_buffer_bytes) << "blocks of points";
    for (const Segment& segment : chunk.segments) {
        const auto columns = static_cast<uint64_t>(segment.num_columns());
        const auto slots = static_cast<uint64_t>(segment.num_slots());
        const auto runs = static_cast<uint64_t>(segment.num_runs());
        EXPECT_LE(slots * (2 * columns + 6) * static_cast<uint64_t>(options.bytes_per_value),
                  options.max_buffer_bytes)
            << "Jacobian";
        EXPECT_LE(slots * 3 * sizeof(double), options.max_buffer_bytes) << "covariances";
        EXPECT_LE(runs * 2 * columns * sizeof(double), options.max_buffer_bytes)
            << "gradients of runs";
        EXPECT_LE(
            runs * columns * (columns + 1) / 2 * static_cast<uint64_t>(options.bytes_per_value),
            options.max_buffer_bytes)
            << "blocks of runs";
    }
}

void expect_tiles(const Problem& problem, const TileOptions& options) {
    const ParameterLayout layout(problem);
    const VisibilityTiles tiles(problem, layout, options);
    expect_points_in_tiles(problem, options, tiles);
    std::vector<int> num_visits(problem.observations.size(), 0);
    int64_t num_slots = 0;
    for (const Chunk& chunk : tiles.chunks) {
        expect_buffers_fit(options, chunk);
        std::set<int32_t> models;
        for (const Segment& segment : chunk.segments) {
            EXPECT_TRUE(models.insert(segment.model).second) << "model " << segment.model;
            expect_runs(problem, options, chunk, segment, num_visits);
            expect_block_runs(problem, layout, segment);
            num_slots += segment.num_slots();
        }
    }
    EXPECT_EQ(num_visits, std::vector<int>(problem.observations.size(), 1));
    EXPECT_EQ(tiles.num_slots, num_slots);
}

TileOptions tile_options(int32_t points_per_tile, int lanes) {
    TileOptions options;
    options.points_per_tile = points_per_tile;
    options.lanes = lanes;
    return options;
}

TEST(VisibilityTiles, EmptyProblemHasNoChunks) {
    const Problem problem;
    const VisibilityTiles tiles(problem, ParameterLayout(problem), TileOptions());
    EXPECT_TRUE(tiles.chunks.empty());
    EXPECT_EQ(tiles.num_slots, 0);
}

TEST(VisibilityTiles, PointsWithoutObservationsHaveSlots) {
    const Problem problem = structure({camera_snavely}, {0, 0}, 10);
    expect_tiles(problem, tile_options(4, 16));
    const VisibilityTiles tiles(problem, ParameterLayout(problem), tile_options(4, 16));
    ASSERT_EQ(tiles.chunks.size(), 1u);
    EXPECT_EQ(tiles.chunks[0].num_tiles(), 3);
    EXPECT_EQ(tiles.num_slots, 0);
}

TEST(VisibilityTiles, OneObservationIsOneRun) {
    Problem problem = structure({camera_opencv}, {0}, 1);
    problem.observations = {{0, 0, 1, 2}};
    expect_tiles(problem, tile_options(64, 8));
    const VisibilityTiles tiles(problem, ParameterLayout(problem), tile_options(64, 8));
    ASSERT_EQ(tiles.chunks.size(), 1u);
    ASSERT_EQ(tiles.chunks[0].segments.size(), 1u);
    const Segment& segment = tiles.chunks[0].segments[0];
    EXPECT_EQ(segment.slot_observation, (std::vector<int32_t>{0, -1, -1, -1, -1, -1, -1, -1}));
    EXPECT_EQ(segment.slot_point, (std::vector<uint16_t>{0, 1, 2, 3, 4, 5, 6, 7}));
    EXPECT_EQ(tiles.chunks[0].num_point_slots, 16);
}

TEST(VisibilityTiles, RepeatedPairsGetRunsOfTheirOwn) {
    Problem problem = structure({camera_snavely}, {0}, 3);
    for (int32_t point : {0, 1, 0, 2, 1, 0}) problem.observations.push_back({0, point, 0, 0});
    expect_tiles(problem, tile_options(64, 4));
    const VisibilityTiles tiles(problem, ParameterLayout(problem), tile_options(64, 4));
    EXPECT_EQ(tiles.chunks[0].segments[0].slot_observation,
              (std::vector<int32_t>{0, 1, 3, -1, 2, 4, -1, -1, 5, -1, -1, -1}));
}

// A tile that ends in a chunk which it does not fit must count repeats anew in the next.
TEST(VisibilityTiles, ManyRepeatedPairsKeepChunksBelowTheLimit) {
    for (int32_t points_per_tile : {1, 2, 7}) {
        Problem problem = structure({camera_snavely, camera_radial}, {0, 1, 1}, 40);
        for (int32_t repeat = 0; repeat < 30; ++repeat)
            for (int32_t point = 0; point < 40; ++point)
                problem.observations.push_back({(point + repeat) % 3, point, 0, 0});
        TileOptions options = tile_options(points_per_tile, 16);
        options.max_buffer_bytes = 300'000;
        expect_tiles(problem, options);
        const VisibilityTiles tiles(problem, ParameterLayout(problem), options);
        EXPECT_GT(tiles.chunks.size(), 1u);
    }
}

TEST(VisibilityTiles, EachModelHasItsSegment) {
    const Problem problem = test::small_scene(13, 80, test::all_camera_models(), false, 3);
    for (int lanes : {1, 3, 16}) expect_tiles(problem, tile_options(11, lanes));
    const VisibilityTiles tiles(problem, ParameterLayout(problem), tile_options(11, 16));
    EXPECT_EQ(tiles.chunks[0].segments.size(), static_cast<size_t>(num_camera_models));
}

TEST(VisibilityTiles, SharedAndOwnedCamerasListTheirRuns) {
    expect_tiles(test::mixed_scene(7, 90, 5), tile_options(16, 16));
    expect_tiles(test::small_scene(8, 50, {camera_pinhole, camera_snavely}, true, 6),
                 tile_options(5, 8));
    expect_tiles(test::planted_trouble(), tile_options(4, 16));
}

TEST(VisibilityTiles, LargestTilesUseAll16Bits) {
    constexpr int32_t most = 65536 - 2 * 16;
    Problem problem = structure({camera_snavely}, {0}, most + 3);
    for (int32_t point = 0; point < problem.num_points(); ++point)
        problem.observations.push_back({0, point, 0, 0});
    expect_tiles(problem, tile_options(most, 16));
    EXPECT_THROW(VisibilityTiles(problem, ParameterLayout(problem), tile_options(most + 1, 16)),
                 Error);
    EXPECT_THROW(VisibilityTiles(problem, ParameterLayout(problem), tile_options(-1, 16)), Error);
    EXPECT_THROW(VisibilityTiles(problem, ParameterLayout(problem), tile_options(4, 0)), Error);
}

TEST(VisibilityTiles, TileBeyondTheLimitIsAnError) {
    const Problem problem = test::small_scene(4, 30, {camera_snavely}, false, 1);
    TileOptions options = tile_options(30, 16);
    options.max_buffer_bytes = 2000;
    try {
        VisibilityTiles(problem, ParameterLayout(problem), options);
        FAIL() << "no error";
    } catch (const Error& error) {
        EXPECT_EQ(error.status(), Status::out_of_memory);
    }
}

TEST(VisibilityTiles, RandomProblemsKeepAllRules) {
    std::mt19937_64 random(8);
    constexpr int lanes_choices[] = {1, 3, 8, 16};
    constexpr int32_t tile_choices[] = {1, 5, 16, 64, 4096};
    int num_chunked = 0;
    for (int round = 0; round < 300; ++round) {
        SCOPED_TRACE(testing::Message() << "round " << round);
        const Problem problem = random_structure(random);
        TileOptions options = tile_options(tile_choices[random() % 5], lanes_choices[random() % 4]);
        options.bytes_per_value = random() % 2 ? 4 : 8;
        expect_tiles(problem, options);
        options.max_buffer_bytes = 20'000 << (random() % 6);
        try {
            expect_tiles(problem, options);
            const VisibilityTiles tiles(problem, ParameterLayout(problem), options);
            num_chunked += tiles.chunks.size() > 1;
        } catch (const Error& error) {
            EXPECT_EQ(error.status(), Status::out_of_memory);
        }
        if (HasFailure()) return;
    }
    EXPECT_GE(num_chunked, 50);
}

int64_t num_runs(const VisibilityTiles& tiles) {
    int64_t number = 0;
    for (const Chunk& chunk : tiles.chunks)
        for (const Segment& segment : chunk.segments) number += segment.num_runs();
    return number;
}

// A path of images; image i sees points 40 i ... 40 i + 119.
Problem path(int num_images, const std::vector<int32_t>& name) {
    Problem problem =
        structure({camera_snavely}, std::vector<int32_t>(name.size(), 0), 40 * num_images + 80);
    for (int32_t point = 0; point < problem.num_points(); ++point)
        for (int32_t image = std::max(0, point / 40 - 2);
             image <= std::min(num_images - 1, point / 40); ++image)
            problem.observations.push_back({name[static_cast<size_t>(image)], point, 0, 0});
    return problem;
}

TEST(VisibilityTiles, NamesOfImagesDoNotMatter) {
    constexpr int num_images = 600;
    std::vector<int32_t> name(num_images);
    std::iota(name.begin(), name.end(), 0);
    const Problem in_order = path(num_images, name);
    std::shuffle(name.begin(), name.end(), std::mt19937_64(2));
    const Problem shuffled = path(num_images, name);
    const TileOptions options = tile_options(400, 16);
    expect_tiles(shuffled, options);
    const VisibilityTiles wanted(in_order, ParameterLayout(in_order), options);
    const VisibilityTiles tiles(shuffled, ParameterLayout(shuffled), options);
    // A tile of 400 points along the path is seen by 12 images; 2 more where it is cut otherwise.
    EXPECT_LE(num_runs(wanted), 12 * wanted.chunks[0].num_tiles());
    EXPECT_LE(num_runs(tiles), 14 * wanted.chunks[0].num_tiles());
}

TEST(VisibilityTiles, ChosenTilesShareTheWorkAndFit) {
    const Problem problem = test::small_scene(40, 3000, {camera_snavely, camera_opencv}, false, 3);
    TileOptions options = tile_options(0, 16);
    options.max_points_per_tile = 500;
    expect_tiles(problem, options);
    options.max_points_per_tile = 16384;
    for (int32_t units : {1, 2, 3, 8}) {
        options.compute_units = units;
        expect_tiles(problem, options);
        const VisibilityTiles tiles(problem, ParameterLayout(problem), options);
        EXPECT_GE(tiles.chunks[0].num_tiles(), units);
    }
    options.compute_units = 1;
    options.max_buffer_bytes = 200'000;  // tiles become smaller rather than too large
    expect_tiles(problem, options);
}

// Large enough for several threads: twice the same, whichever takes which tile.
TEST(VisibilityTiles, TilesAreTheSameTwice) {
    const Problem problem = test::small_scene(60, 40000, {camera_snavely}, false, 5);
    const TileOptions options = tile_options(0, 16);
    expect_tiles(problem, options);
    const VisibilityTiles a(problem, ParameterLayout(problem), options);
    const VisibilityTiles b(problem, ParameterLayout(problem), options);
    ASSERT_EQ(a.chunks.size(), b.chunks.size());
    for (size_t c = 0; c < a.chunks.size(); ++c) {
        EXPECT_EQ(a.chunks[c].slot_point, b.chunks[c].slot_point);
        for (size_t s = 0; s < a.chunks[c].segments.size(); ++s) {
            EXPECT_EQ(a.chunks[c].segments[s].run_image, b.chunks[c].segments[s].run_image);
            EXPECT_EQ(a.chunks[c].segments[s].slot_observation,
                      b.chunks[c].segments[s].slot_observation);
        }
    }
}

}  // namespace
}  // namespace clba
