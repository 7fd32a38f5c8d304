// SPDX-License-Identifier: Apache-2.0
// Problems in files, and what files hold beside them.
#include <filesystem>

#include "api/handles.hpp"
#include "io/bal.hpp"

namespace clba {
namespace {

#define CLBA_SAME_FORMAT(name, number)                        \
    static_assert(static_cast<int>(Format::name) == (number), \
                  "Format must have the numbers of CLBA_FORMAT_*");
CLBA_SAME_FORMAT(automatic, CLBA_FORMAT_AUTO)
CLBA_SAME_FORMAT(bal, CLBA_FORMAT_BAL)
CLBA_SAME_FORMAT(colmap_binary, CLBA_FORMAT_COLMAP_BINARY)
CLBA_SAME_FORMAT(colmap_text, CLBA_FORMAT_COLMAP_TEXT)
CLBA_SAME_FORMAT(bundler, CLBA_FORMAT_BUNDLER)
CLBA_SAME_FORMAT(nvm, CLBA_FORMAT_NVM)
CLBA_SAME_FORMAT(openmvg, CLBA_FORMAT_OPENMVG)
CLBA_SAME_FORMAT(opensfm, CLBA_FORMAT_OPENSFM)
CLBA_SAME_FORMAT(ply, CLBA_FORMAT_PLY)
#undef CLBA_SAME_FORMAT

clba_read_options default_read_options() {
    clba_read_options options{};
    options.struct_size = sizeof options;
    return options;
}

clba_write_options default_write_options() {
    clba_write_options options{};
    options.struct_size = sizeof options;
    return options;
}

Format checked_format(int32_t format) {
    if (clba_format_name(format)) return static_cast<Format>(format);
    std::string known;
    for (const FileFormat& row : file_formats())
        known +=
            text(known.empty() ? "" : ", ", static_cast<int32_t>(row.format), " (", row.name, ")");
    fail(Status::invalid_argument, "format = ", format, ", but it must be 0 (auto) or one of ",
         known);
}

clba_problem* read(const char* path, const clba_read_options& options) {
    std::function<bool(double)> on_progress;
    if (options.on_progress)
        on_progress = [&options](double fraction) {
            return options.on_progress(fraction, options.user_data) != 0;
        };
    auto handle = std::make_unique<clba_problem>();
    ReadFile file = read_reconstruction(path, checked_format(options.format), on_progress);
    handle->reconstruction = std::move(file.reconstruction);
    handle->format = file.format;
    for (const std::string& notice : handle->reconstruction.notices)
        handle->notices += (handle->notices.empty() ? "" : "\n") + notice;
    return handle.release();
}

// The row of the format to write, once nothing speaks against it.
const FileFormat& output_format(const clba_problem& problem, const char* path,
                                const clba_write_options* options) {
    const clba_write_options given = copied_in(options, default_write_options(), "options");
    require(given.reserved == 0, "reserved = ", given.reserved, ", but it must be 0");
    require(given.accept_loss == 0 || given.accept_loss == 1, "accept_loss = ", given.accept_loss,
            ", but it must be 0 or 1");
    Format format = checked_format(given.format);
    if (format == Format::automatic) format = format_for_output(path, problem.format);
    const FileFormat& row = *find_format(format);
    std::string all;
    for (const std::string& loss : losses(problem.reconstruction, row))
        all += (all.empty() ? "" : "; ") + loss;
    require(given.accept_loss || all.empty(), path, ": files of the format ", row.name,
            " do not hold ", all,
            ". Accept the loss (option accept_loss), or write another format");
    std::error_code error;
    const auto status = std::filesystem::status(path, error);
    if (std::filesystem::exists(status) && std::filesystem::is_directory(status) != row.is_folder)
        fail(Status::file, "cannot write ", path, " in the format ", row.name,
             row.is_folder ? ": it is not a folder; name a folder, which may be a new one"
                           : ": it is a folder; name a file in it");
    return row;
}

// Of optional rows [first, first + count), of which there are num_rows or none: set(i, row), where
// row is the default if there are none.
template <class Row, class Set>
void for_rows(const std::vector<Row>& rows, int64_t first, int64_t count, const Set& set) {
    for (int64_t i = 0; i < count; ++i) {
        Row missing;
        missing.id = static_cast<uint64_t>(first + i + 1);
        set(i, rows.empty() ? missing : rows[first + i]);
    }
}

}  // namespace
}  // namespace clba

using namespace clba;

const char* clba_format_name(int32_t format) {
    if (format == CLBA_FORMAT_AUTO) return "auto";
    const FileFormat* const row = find_format(static_cast<Format>(format));
    return row ? row->name : nullptr;
}

clba_status clba_read_options_init(clba_read_options* options, size_t struct_size) {
    return guarded([&] { init_struct(options, struct_size, default_read_options(), "options"); });
}

clba_status clba_problem_read(const char* path, const clba_read_options* options,
                              clba_problem** problem) {
    if (problem) *problem = nullptr;
    return guarded([&] {
        require_pointer(path, "path");
        require_pointer(problem, "problem");
        *problem = read(path, copied_in(options, default_read_options(), "options"));
    });
}

const char* clba_problem_notices(const clba_problem* problem) {
    return problem ? problem->notices.c_str() : "";
}

int32_t clba_problem_get_format(const clba_problem* problem) {
    return problem ? static_cast<int32_t>(problem->format) : CLBA_FORMAT_AUTO;
}

clba_status clba_write_options_init(clba_write_options* options, size_t struct_size) {
    return guarded([&] { init_struct(options, struct_size, default_write_options(), "options"); });
}

clba_status clba_problem_write(const clba_problem* problem, const char* path,
                               const clba_write_options* options) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(path, "path");
        output_format(*problem, path, options).write(problem->reconstruction, path);
    });
}

clba_status clba_problem_check_write(const clba_problem* problem, const char* path,
                                     const clba_write_options* options) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(path, "path");
        output_format(*problem, path, options);
    });
}

clba_status clba_problem_get_camera_info(const clba_problem* problem, int32_t first, int32_t count,
                                         uint64_t* ids, size_t ids_stride, uint64_t* sizes,
                                         size_t sizes_stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_range(first, count, problem->problem.num_cameras(), "cameras");
        const Rows id_rows(ids, ids_stride, 1, "ids", 0);
        const Rows size_rows(sizes, sizes_stride, 2, "sizes", 0);
        for_rows(problem->reconstruction.cameras, first, count,
                 [&](int64_t i, const CameraInfo& row) {
                     if (ids) id_rows.set(i, 0, row.id);
                     if (!sizes) return;
                     size_rows.set(i, 0, row.width);
                     size_rows.set(i, 1, row.height);
                 });
    });
}

clba_status clba_problem_get_image_ids(const clba_problem* problem, int32_t first, int32_t count,
                                       uint64_t* ids, size_t stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_range(first, count, problem->problem.num_images(), "images");
        const Rows rows(ids, stride, 1, "ids", count);
        for_rows(problem->reconstruction.images, first, count,
                 [&](int64_t i, const ImageInfo& row) { rows.set(i, 0, row.id); });
    });
}

clba_status clba_problem_get_point_info(const clba_problem* problem, int32_t first, int32_t count,
                                        uint64_t* ids, size_t ids_stride, uint8_t* colors,
                                        size_t colors_stride) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_range(first, count, problem->problem.num_points(), "points");
        const Rows id_rows(ids, ids_stride, 1, "ids", 0);
        const Rows color_rows(colors, colors_stride, 3, "colors", 0);
        for_rows(problem->reconstruction.points, first, count,
                 [&](int64_t i, const PointInfo& row) {
                     if (ids) id_rows.set(i, 0, row.id);
                     for (size_t k = 0; colors && k < 3; ++k) color_rows.set(i, k, row.color[k]);
                 });
    });
}

const char* clba_problem_get_image_name(const clba_problem* problem, int32_t image) {
    if (!problem || image < 0 || image >= problem->problem.num_images()) return nullptr;
    const auto& images = problem->reconstruction.images;
    return images.empty() ? "" : images[image].name.c_str();
}

clba_status clba_problem_read_bal(const char* path, clba_problem** problem) {
    clba_read_options options = default_read_options();
    options.format = CLBA_FORMAT_BAL;
    return clba_problem_read(path, &options, problem);
}

clba_status clba_problem_write_bal(const clba_problem* problem, const char* path) {
    return guarded([&] {
        require_pointer(problem, "problem");
        require_pointer(path, "path");
        write_bal(problem->problem, path);
    });
}

clba_status clba_problem_write_ply(const clba_problem* problem, const char* path) {
    clba_write_options options = default_write_options();
    options.format = CLBA_FORMAT_PLY;
    return clba_problem_write(problem, path, &options);
}
