// SPDX-License-Identifier: Apache-2.0
// Lines of words separated by spaces; lines that begin with # are comments. Numbers are written
// with 17 digits, as COLMAP does.
#include <algorithm>
#include <atomic>
#include <charconv>
#include <cmath>

#include "base/error.hpp"
#include "base/parallel.hpp"
#include "io/colmap_model.hpp"
#include "io/file_content.hpp"
#include "io/number_reader.hpp"
#include "io/read_progress.hpp"
#include "io/text_input.hpp"

namespace clba::colmap {
namespace {

constexpr size_t chunk_bytes = size_t{1} << 20;

// The words of a line.
class Line {
public:
    Line(const FileContent& file, std::string_view line) : file_(file), rest_(line) {
        while (!rest_.empty() && is_space(rest_.back())) rest_.remove_suffix(1);
        skip_space();
    }
    bool is_at_end() const { return rest_.empty(); }
    bool is_comment() const { return !rest_.empty() && rest_.front() == '#'; }

    std::string_view word(const char* what) {
        if (rest_.empty()) fail_here("the line ends where ", what, " was expected");
        size_t size = 0;
        while (size < rest_.size() && !is_space(rest_[size])) ++size;
        const std::string_view word = rest_.substr(0, size);
        rest_.remove_prefix(size);
        skip_space();
        return word;
    }
    // All that is left, which may hold spaces.
    std::string_view rest() {
        const std::string_view all = rest_;
        rest_ = {};
        return all;
    }
    double number(const char* what) {
        const std::string_view digits = word(what);
        double value = 0;
        if (!parse_number(digits, value) || !std::isfinite(value))
            fail_here(what, " is '", shown(digits), "', but it must be a finite number");
        return value;
    }
    template <class Integer>
    Integer integer(const char* what) {
        return parsed<Integer>(word(what), what);
    }
    // -1 is no point.
    uint64_t point_id(const char* what) {
        const std::string_view digits = word(what);
        return digits == "-1" ? no_point : parsed<uint64_t>(digits, what);
    }
    Pose pose(const char* what) {
        Pose pose;
        for (double& value : pose.rotation) value = number(what);
        for (double& value : pose.translation) value = number(what);
        return pose;
    }
    Sensor sensor() {
        const std::string_view name = word("a sensor's kind");
        for (int32_t kind = 0; kind < static_cast<int32_t>(std::size(sensor_kinds)); ++kind)
            if (name == sensor_kinds[kind]) return {kind, integer<uint32_t>("a sensor's id")};
        fail_here("the kind of a sensor is '", shown(name), "', but it must be CAMERA or IMU");
    }
    void expect_end(const char* last) {
        if (!rest_.empty())
            fail_here("'", shown(rest_), "' follows ", last, ", where the line must end");
    }
    template <class... Parts>
    [[noreturn]] void fail_here(const Parts&... parts) const {
        fail(Status::format, file_.path(), ":", file_.line_at(rest_.data()), ": ", parts...);
    }
    const FileContent& file() const { return file_; }

private:
    template <class Integer>
    Integer parsed(std::string_view digits, const char* what) const {
        Integer value = 0;
        const char* const end = digits.data() + digits.size();
        const auto [stop, error] = std::from_chars(digits.data(), end, value);
        if (stop != end || error != std::errc())
            fail_here(what, " is '", shown(digits), "', but it must be an integer from 0 to ",
                      text(+std::numeric_limits<Integer>::max()));
        return value;
    }
    void skip_space() {
        while (!rest_.empty() && is_space(rest_.front())) rest_.remove_prefix(1);
    }

    const FileContent& file_;
    std::string_view rest_;
};

// Takes the first line off a text.
std::string_view take_line(std::string_view& text) {
    const size_t end = std::min(text.find('\n'), text.size());
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    return line;
}

// use(Line) of every line that is not empty and no comment.
template <class Use>
void for_each_line(const FileContent& file, std::string_view text, const Use& use) {
    while (!text.empty()) {
        Line line(file, take_line(text));
        if (!line.is_at_end() && !line.is_comment()) use(line);
    }
}

// parse(chunk, part) of each chunk, on all threads, and append(part) of each in order. bytes_of a
// chunk are for the progress.
template <class Part, class Chunk, class Parse, class BytesOf, class Append>
void parse_in_parallel(const std::vector<Chunk>& chunks, const Parse& parse,
                       const BytesOf& bytes_of, const Append& append) {
    std::vector<Part> parts(chunks.size());
    std::atomic<int64_t> parsed{0};
    parallel_for(static_cast<int64_t>(chunks.size()), [&](int64_t i, int worker) {
        parse(chunks[i], parts[i]);
        parsed += static_cast<int64_t>(bytes_of(chunks[i]));
        if (worker == 0) ReadProgress::add(parsed.exchange(0));
    });
    ReadProgress::add(parsed);
    for (Part& part : parts) append(std::exchange(part, {}));
}

void read_cameras(const std::string& folder, Model& model) {
    const FileContent file(folder + "/cameras.txt");
    for_each_line(file, file.bytes(), [&](Line& line) {
        CameraRow row;
        row.id = line.integer<uint32_t>("a camera's id");
        row.camera.model = number_of_model_name(line.word("a camera's model"), row.id, file.path());
        row.width = line.integer<uint64_t>("a camera's width");
        row.height = line.integer<uint64_t>("a camera's height");
        for (int k = 0; k < row.camera.num_params(); ++k)
            row.camera.params[k] = line.number("a camera's parameter");
        line.expect_end("the camera's last parameter");
        model.cameras.push_back(row);
    });
}

void read_rigs(const std::string& folder, Model& model) {
    const FileContent file(folder + "/rigs.txt");
    for_each_line(file, file.bytes(), [&](Line& line) {
        Rig rig;
        rig.id = line.integer<uint32_t>("a rig's id");
        const auto count = line.integer<uint32_t>("a rig's number of sensors");
        for (uint32_t i = 0; i < count; ++i) {
            RigSensor row;
            row.sensor = line.sensor();
            if (i > 0) {
                row.has_pose = line.integer<uint8_t>("whether a sensor has a pose") != 0;
                if (row.has_pose) row.sensor_from_rig = line.pose("a sensor's pose");
            }
            rig.sensors.push_back(row);
        }
        line.expect_end("the rig's last sensor");
        model.rigs.push_back(std::move(rig));
    });
}

void read_frames(const std::string& folder, Model& model) {
    const FileContent file(folder + "/frames.txt");
    for_each_line(file, file.bytes(), [&](Line& line) {
        Frame frame;
        frame.id = line.integer<uint32_t>("a frame's id");
        frame.rig = line.integer<uint32_t>("a frame's rig");
        frame.rig_from_world = line.pose("a frame's pose");
        const auto count = line.integer<uint32_t>("a frame's number of data");
        for (uint32_t i = 0; i < count; ++i) {
            const Sensor sensor = line.sensor();
            frame.data.push_back({sensor, line.integer<uint64_t>("a frame's datum")});
        }
        line.expect_end("the frame's last datum");
        model.frames.push_back(std::move(frame));
    });
}

struct ImageLines {
    std::string_view image, features;
};

struct ImagesPart {
    std::vector<ImageRow> images;
    std::vector<FeatureRow> features;
};

void parse_image(const FileContent& file, const ImageLines& lines, ImagesPart& part) {
    ImageRow row;
    Line line(file, lines.image);
    row.id = line.integer<uint32_t>("an image's id");
    row.pose = line.pose("an image's pose");
    row.camera = line.integer<uint32_t>("an image's camera");
    row.name = line.rest();
    row.first_feature = part.features.size();
    for (Line features(file, lines.features); !features.is_at_end();) {
        const double x = features.number("a feature's x");
        const double y = features.number("a feature's y");
        part.features.push_back({x, y, features.point_id("a feature's point")});
    }
    row.num_features = part.features.size() - row.first_feature;
    part.images.push_back(std::move(row));
}

void read_images(const std::string& folder, Model& model) {
    const FileContent file(folder + "/images.txt");
    std::vector<std::vector<ImageLines>> chunks;
    size_t bytes_in_chunk = chunk_bytes;
    for (std::string_view text = file.bytes(); !text.empty();) {
        const std::string_view first = take_line(text);
        const Line line(file, first);
        if (line.is_at_end() || line.is_comment()) continue;
        if (bytes_in_chunk >= chunk_bytes) {
            chunks.emplace_back();
            bytes_in_chunk = 0;
        }
        chunks.back().push_back({first, take_line(text)});
        bytes_in_chunk += first.size() + chunks.back().back().features.size();
    }
    parse_in_parallel<ImagesPart>(
        chunks,
        [&](const std::vector<ImageLines>& chunk, ImagesPart& part) {
            for (const ImageLines& lines : chunk) parse_image(file, lines, part);
        },
        [](const std::vector<ImageLines>& chunk) {
            size_t bytes = 0;
            for (const ImageLines& lines : chunk)
                bytes += lines.image.size() + lines.features.size();
            return bytes;
        },
        [&](ImagesPart part) {
            for (ImageRow& row : part.images) {
                row.first_feature += model.features.size();
                model.images.push_back(std::move(row));
            }
            model.features.insert(model.features.end(), part.features.begin(), part.features.end());
        });
}

struct PointsPart {
    std::vector<PointRow> points;
    std::vector<TrackElement> elements;
};

void parse_point(Line& line, PointsPart& part) {
    PointRow row;
    row.info.id = line.integer<uint64_t>("a point's id");
    for (double& value : row.position) value = line.number("a point's coordinate");
    for (uint8_t& value : row.info.color) value = line.integer<uint8_t>("a point's colour");
    row.info.error = line.number("a point's error");
    row.first_element = part.elements.size();
    while (!line.is_at_end()) {
        const auto image = line.integer<uint32_t>("a track's image");
        part.elements.push_back({image, line.integer<uint32_t>("a track's feature")});
    }
    row.num_elements = part.elements.size() - row.first_element;
    part.points.push_back(row);
}

void read_points(const std::string& folder, Model& model) {
    const FileContent file(folder + "/points3D.txt");
    std::vector<std::string_view> chunks;
    for (std::string_view text = file.bytes(); !text.empty();) {
        const size_t end =
            std::min(text.find('\n', std::min(chunk_bytes, text.size())), text.size() - 1) + 1;
        chunks.push_back(text.substr(0, end));
        text.remove_prefix(end);
    }
    parse_in_parallel<PointsPart>(
        chunks,
        [&](std::string_view chunk, PointsPart& part) {
            for_each_line(file, chunk, [&](Line& line) { parse_point(line, part); });
        },
        [](std::string_view chunk) { return chunk.size(); },
        [&](PointsPart part) {
            for (PointRow& row : part.points) {
                row.first_element += model.elements.size();
                model.points.push_back(row);
            }
            model.elements.insert(model.elements.end(), part.elements.begin(), part.elements.end());
        });
}

class Writer {
public:
    explicit Writer(AtomicFile& file) : blocks_(file) {}

    template <class... Values>
    void put(const Values&... values) {
        (put_one(values), ...);
    }
    // Each followed by a space.
    void put_pose(const Pose& pose) {
        for (double value : pose.rotation) put(value, " ");
        for (double value : pose.translation) put(value, " ");
    }
    void flush() { blocks_.flush(); }

private:
    void put_one(std::string_view characters) { blocks_.put(characters); }
    void put_one(double value) {
        constexpr int digits = 17;
        char characters[32];
        put_end(characters, std::to_chars(characters, characters + sizeof characters, value,
                                          std::chars_format::general, digits)
                                .ptr);
    }
    template <class Integer, class = std::enable_if_t<std::is_integral_v<Integer>>>
    void put_one(Integer value) {
        char characters[24];
        put_end(characters, std::to_chars(characters, characters + sizeof characters, value).ptr);
    }
    void put_end(const char* begin, const char* end) {
        blocks_.put({begin, static_cast<size_t>(end - begin)});
    }

    BlockWriter blocks_;
};

void write_cameras(const Model& model, Writer& file) {
    file.put("# Camera list with one line of data per camera:\n",
             "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n",  //
             "# Number of cameras: ", model.cameras.size(), "\n");
    for (const CameraRow& row : model.cameras) {
        file.put(row.id, " ", model_name(row.camera.model), " ", row.width, " ", row.height);
        for (int k = 0; k < row.camera.num_params(); ++k) file.put(" ", row.camera.params[k]);
        file.put("\n");
    }
}

std::string words(const Sensor& sensor) {
    return text(sensor_kinds[sensor.kind], " ", sensor.id);
}

void write_rigs(const Model& model, Writer& file) {
    file.put("# Rig calib list with one line of data per calib:\n",
             "#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, "
             "SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])\n",
             "# Number of rigs: ", model.rigs.size(), "\n");
    for (const Rig& rig : model.rigs) {
        file.put(rig.id, " ", rig.sensors.size());
        for (const RigSensor& row : rig.sensors) {
            file.put(" ", words(row.sensor));
            if (&row == &rig.sensors.front()) continue;
            file.put(row.has_pose ? " 1" : " 0");
            if (!row.has_pose) continue;
            for (double value : row.sensor_from_rig.rotation) file.put(" ", value);
            for (double value : row.sensor_from_rig.translation) file.put(" ", value);
        }
        file.put("\n");
    }
}

void write_frames(const Model& model, Writer& file) {
    file.put("# Frame list with one line of data per frame:\n",
             "#   FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, "
             "DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)\n",
             "# Number of frames: ", model.frames.size(), "\n");
    for (const Frame& frame : model.frames) {
        file.put(frame.id, " ", frame.rig, " ");
        file.put_pose(frame.rig_from_world);
        file.put(frame.data.size());
        for (const FrameDatum& datum : frame.data)
            file.put(" ", words(datum.sensor), " ", datum.id);
        file.put("\n");
    }
}

double mean(size_t sum, size_t count) {
    return count ? static_cast<double>(sum) / static_cast<double>(count) : 0;
}

void write_images(const Model& model, Writer& file) {
    file.put("# Image list with two lines of data per image:\n",
             "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n",
             "#   POINTS2D[] as (X, Y, POINT3D_ID)\n",  //
             "# Number of images: ", model.images.size(),
             ", mean observations per image: ", mean(model.elements.size(), model.images.size()),
             "\n");
    for (const ImageRow& row : model.images) {
        require(row.name.find('\n') == std::string::npos, "image ", row.id,
                " has a name of several lines, which COLMAP's text files cannot hold; write a "
                "binary model");
        file.put(row.id, " ");
        file.put_pose(row.pose);
        file.put(row.camera, " ", row.name, "\n");
        for (size_t k = 0; k < row.num_features; ++k) {
            const FeatureRow& feature = model.features[row.first_feature + k];
            file.put(feature.x, " ", feature.y, " ");
            if (feature.point == no_point)
                file.put("-1 ");
            else
                file.put(feature.point, " ");
        }
        file.put("\n");
    }
}

void write_points(const Model& model, Writer& file) {
    file.put("# 3D point list with one line of data per point:\n",
             "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n",
             "# Number of points: ", model.points.size(),
             ", mean track length: ", mean(model.elements.size(), model.points.size()), "\n");
    for (const PointRow& row : model.points) {
        file.put(row.info.id, " ");
        for (double value : row.position) file.put(value, " ");
        for (uint8_t value : row.info.color) file.put(int{value}, " ");
        file.put(row.info.error, " ");
        for (size_t k = 0; k < row.num_elements; ++k) {
            const TrackElement& element = model.elements[row.first_element + k];
            file.put(element.image, " ", element.feature, k + 1 < row.num_elements ? " " : "");
        }
        file.put("\n");
    }
}

}  // namespace

Model read_text(const std::string& folder) {
    Model model;
    read_cameras(folder, model);
    if (model.has_frames = has_frame_files(folder, ".txt"); model.has_frames) {
        read_rigs(folder, model);
        read_frames(folder, model);
    }
    read_images(folder, model);
    read_points(folder, model);
    return model;
}

void write_text(const Model& model, OutputFolder& folder) {
    const auto write = [&](const char* name, void (*rows)(const Model&, Writer&)) {
        Writer file(folder.add(name));
        rows(model, file);
        file.flush();
    };
    write("cameras.txt", write_cameras);
    write("images.txt", write_images);
    write("points3D.txt", write_points);
    if (model.has_frames) {
        write("rigs.txt", write_rigs);
        write("frames.txt", write_frames);
    } else {
        folder.add_removal("rigs.txt");
        folder.add_removal("frames.txt");
    }
}

}  // namespace clba::colmap
