// SPDX-License-Identifier: Apache-2.0
// Integers and doubles are little-endian and follow each other without gaps.
#include <cmath>
#include <cstring>

#include "base/error.hpp"
#include "io/colmap_model.hpp"
#include "io/file_content.hpp"
#include "io/read_progress.hpp"

namespace clba::colmap {
namespace {

constexpr int64_t progress_bytes = int64_t{1} << 22;

class Reader {
public:
    Reader(const std::string& folder, const char* name)
        : file_(folder + "/" + name), rest_(file_.bytes()) {}

    template <class Value>
    Value take(const char* what) {
        if (rest_.size() < sizeof(Value))
            fail_here("ends where ", what, " was expected; it is truncated or a count is wrong");
        Value value;
        if constexpr (std::is_same_v<Value, double>) {
            const auto bits = take<uint64_t>(what);
            std::memcpy(&value, &bits, sizeof value);
            if (!std::isfinite(value)) fail_here("has ", what, " = ", value, ", not finite");
        } else {
            std::make_unsigned_t<Value> bits = 0;
            for (size_t k = 0; k < sizeof(Value); ++k)
                bits = static_cast<std::make_unsigned_t<Value>>(
                    bits | std::make_unsigned_t<Value>{static_cast<unsigned char>(rest_[k])}
                               << 8 * k);
            value = static_cast<Value>(bits);
            rest_.remove_prefix(sizeof value);
        }
        return value;
    }

    // A number of rows, of which the rest of the file can hold so many.
    size_t take_count(uint64_t count, const char* rows, size_t least_bytes_per_row) const {
        if (count > rest_.size() / least_bytes_per_row)
            fail_here("claims ", count, " ", rows, ", but only ", rest_.size(),
                      " bytes follow; it is truncated or no file of COLMAP");
        return static_cast<size_t>(count);
    }

    Pose pose(const char* what) {
        Pose pose;
        for (double& value : pose.rotation) value = take<double>(what);
        for (double& value : pose.translation) value = take<double>(what);
        return pose;
    }

    Sensor sensor(const char* what) {
        const auto kind = take<int32_t>(what);
        return {kind, take<uint32_t>(what)};
    }

    std::string text_to_nul(const char* what) {
        const size_t end = rest_.find('\0');
        if (end == std::string_view::npos) fail_here("ends inside ", what);
        std::string text(rest_.substr(0, end));
        rest_.remove_prefix(end + 1);
        return text;
    }

    // Tells of progress once in a while.
    void row_done() {
        const auto done = static_cast<int64_t>(file_.bytes().size() - rest_.size());
        if (done - reported_ >= progress_bytes) report(done);
    }
    void expect_end(const char* last) {
        if (!rest_.empty())
            fail_here("has ", rest_.size(), " bytes after ", last,
                      ", but must end there; its count is wrong");
        report(static_cast<int64_t>(file_.bytes().size()));
    }

    template <class... Parts>
    [[noreturn]] void fail_here(const Parts&... parts) const {
        fail(Status::format, file_.path(), " (byte ", file_.bytes().size() - rest_.size(), ") ",
             parts...);
    }
    const std::string& path() const { return file_.path(); }

private:
    void report(int64_t done) {
        ReadProgress::add(done - reported_);
        reported_ = done;
    }

    FileContent file_;
    std::string_view rest_;
    int64_t reported_ = 0;
};

void read_cameras(const std::string& folder, Model& model) {
    Reader file(folder, "cameras.bin");
    const size_t count =
        file.take_count(file.take<uint64_t>("the number of cameras"), "cameras", 24);
    model.cameras.reserve(count);
    for (size_t i = 0; i < count; ++i) {
        CameraRow row;
        row.id = file.take<uint32_t>("a camera's id");
        row.camera.model =
            number_of_model_id(file.take<int32_t>("a camera's model"), row.id, file.path());
        row.width = file.take<uint64_t>("a camera's width");
        row.height = file.take<uint64_t>("a camera's height");
        for (int k = 0; k < row.camera.num_params(); ++k)
            row.camera.params[k] = file.take<double>("a camera's parameter");
        model.cameras.push_back(row);
    }
    file.expect_end("the last camera");
}

void read_rigs(const std::string& folder, Model& model) {
    Reader file(folder, "rigs.bin");
    const size_t count = file.take_count(file.take<uint64_t>("the number of rigs"), "rigs", 8);
    model.rigs.resize(count);
    for (Rig& rig : model.rigs) {
        rig.id = file.take<uint32_t>("a rig's id");
        rig.sensors.resize(
            file.take_count(file.take<uint32_t>("a rig's number of sensors"), "sensors", 8));
        for (RigSensor& row : rig.sensors) {
            row.sensor = file.sensor("a rig's sensor");
            if (&row == &rig.sensors.front()) continue;
            const auto has_pose = file.take<uint8_t>("whether a sensor has a pose");
            if (has_pose > 1)
                file.fail_here("says ", int{has_pose},
                               " for whether a sensor has a pose, not 0 or 1");
            row.has_pose = has_pose;
            if (row.has_pose) row.sensor_from_rig = file.pose("a sensor's pose");
        }
    }
    file.expect_end("the last rig");
}

void read_frames(const std::string& folder, Model& model) {
    Reader file(folder, "frames.bin");
    const size_t count = file.take_count(file.take<uint64_t>("the number of frames"), "frames", 68);
    model.frames.resize(count);
    for (Frame& frame : model.frames) {
        frame.id = file.take<uint32_t>("a frame's id");
        frame.rig = file.take<uint32_t>("a frame's rig");
        frame.rig_from_world = file.pose("a frame's pose");
        frame.data.resize(
            file.take_count(file.take<uint32_t>("a frame's number of data"), "data", 16));
        for (FrameDatum& datum : frame.data) {
            datum.sensor = file.sensor("a frame's sensor");
            datum.id = file.take<uint64_t>("a frame's datum");
        }
    }
    file.expect_end("the last frame");
}

void read_images(const std::string& folder, Model& model) {
    Reader file(folder, "images.bin");
    const size_t count = file.take_count(file.take<uint64_t>("the number of images"), "images", 73);
    model.images.reserve(count);
    for (size_t i = 0; i < count; ++i) {
        ImageRow row;
        row.id = file.take<uint32_t>("an image's id");
        row.pose = file.pose("an image's pose");
        row.camera = file.take<uint32_t>("an image's camera");
        row.name = file.text_to_nul("an image's name");
        row.first_feature = model.features.size();
        row.num_features =
            file.take_count(file.take<uint64_t>("an image's number of features"), "features", 24);
        for (size_t k = 0; k < row.num_features; ++k) {
            FeatureRow& feature = model.features.emplace_back();
            feature.x = file.take<double>("a feature's x");
            feature.y = file.take<double>("a feature's y");
            feature.point = file.take<uint64_t>("a feature's point");
        }
        model.images.push_back(std::move(row));
        file.row_done();
    }
    file.expect_end("the last image");
}

void read_points(const std::string& folder, Model& model) {
    Reader file(folder, "points3D.bin");
    const size_t count = file.take_count(file.take<uint64_t>("the number of points"), "points", 51);
    model.points.reserve(count);
    for (size_t i = 0; i < count; ++i) {
        PointRow row;
        row.info.id = file.take<uint64_t>("a point's id");
        for (double& value : row.position) value = file.take<double>("a point's coordinate");
        for (uint8_t& value : row.info.color) value = file.take<uint8_t>("a point's colour");
        row.info.error = file.take<double>("a point's error");
        row.first_element = model.elements.size();
        row.num_elements =
            file.take_count(file.take<uint64_t>("a track's length"), "elements of a track", 8);
        for (size_t k = 0; k < row.num_elements; ++k) {
            TrackElement& element = model.elements.emplace_back();
            element.image = file.take<uint32_t>("a track's image");
            element.feature = file.take<uint32_t>("a track's feature");
        }
        model.points.push_back(row);
        file.row_done();
    }
    file.expect_end("the last point");
}

class Writer {
public:
    explicit Writer(AtomicFile& file) : blocks_(file) {}

    template <class Value>
    void put(Value value) {
        if constexpr (std::is_same_v<Value, double>) {
            uint64_t bits;
            std::memcpy(&bits, &value, sizeof bits);
            put(bits);
        } else {
            const auto bits = static_cast<std::make_unsigned_t<Value>>(value);
            char bytes[sizeof(Value)];
            for (size_t k = 0; k < sizeof(Value); ++k)
                bytes[k] = static_cast<char>(bits >> 8 * k & 255);
            blocks_.put({bytes, sizeof bytes});
        }
    }
    void put_text(const std::string& text) { blocks_.put({text.c_str(), text.size() + 1}); }
    void put_pose(const Pose& pose) {
        for (double value : pose.rotation) put(value);
        for (double value : pose.translation) put(value);
    }
    void put_sensor(const Sensor& sensor) {
        put(sensor.kind);
        put(sensor.id);
    }
    void flush() { blocks_.flush(); }

private:
    BlockWriter blocks_;
};

void write_cameras(const Model& model, Writer& file) {
    file.put(uint64_t{model.cameras.size()});
    for (const CameraRow& row : model.cameras) {
        file.put(row.id);
        file.put(model_id(row.camera.model));
        file.put(row.width);
        file.put(row.height);
        for (int k = 0; k < row.camera.num_params(); ++k) file.put(row.camera.params[k]);
    }
}

void write_rigs(const Model& model, Writer& file) {
    file.put(uint64_t{model.rigs.size()});
    for (const Rig& rig : model.rigs) {
        file.put(static_cast<uint32_t>(rig.id));
        file.put(static_cast<uint32_t>(rig.sensors.size()));
        for (const RigSensor& row : rig.sensors) {
            file.put_sensor(row.sensor);
            if (&row == &rig.sensors.front()) continue;
            file.put(uint8_t{row.has_pose});
            if (row.has_pose) file.put_pose(row.sensor_from_rig);
        }
    }
}

void write_frames(const Model& model, Writer& file) {
    file.put(uint64_t{model.frames.size()});
    for (const Frame& frame : model.frames) {
        file.put(static_cast<uint32_t>(frame.id));
        file.put(static_cast<uint32_t>(frame.rig));
        file.put_pose(frame.rig_from_world);
        file.put(static_cast<uint32_t>(frame.data.size()));
        for (const FrameDatum& datum : frame.data) {
            file.put_sensor(datum.sensor);
            file.put(datum.id);
        }
    }
}

void write_images(const Model& model, Writer& file) {
    file.put(uint64_t{model.images.size()});
    for (const ImageRow& row : model.images) {
        file.put(row.id);
        file.put_pose(row.pose);
        file.put(row.camera);
        file.put_text(row.name);
        file.put(uint64_t{row.num_features});
        for (size_t k = 0; k < row.num_features; ++k) {
            const FeatureRow& feature = model.features[row.first_feature + k];
            file.put(feature.x);
            file.put(feature.y);
            file.put(feature.point);
        }
    }
}

void write_points(const Model& model, Writer& file) {
    file.put(uint64_t{model.points.size()});
    for (const PointRow& row : model.points) {
        file.put(row.info.id);
        for (double value : row.position) file.put(value);
        for (uint8_t value : row.info.color) file.put(value);
        file.put(row.info.error);
        file.put(uint64_t{row.num_elements});
        for (size_t k = 0; k < row.num_elements; ++k) {
            file.put(model.elements[row.first_element + k].image);
            file.put(model.elements[row.first_element + k].feature);
        }
    }
}

}  // namespace

Model read_binary(const std::string& folder) {
    Model model;
    read_cameras(folder, model);
    if (model.has_frames = has_frame_files(folder, ".bin"); model.has_frames) {
        read_rigs(folder, model);
        read_frames(folder, model);
    }
    read_images(folder, model);
    read_points(folder, model);
    return model;
}

void write_binary(const Model& model, OutputFolder& folder) {
    const auto write = [&](const char* name, void (*rows)(const Model&, Writer&)) {
        Writer file(folder.add(name));
        rows(model, file);
        file.flush();
    };
    write("cameras.bin", write_cameras);
    write("images.bin", write_images);
    write("points3D.bin", write_points);
    if (model.has_frames) {
        write("rigs.bin", write_rigs);
        write("frames.bin", write_frames);
    } else {
        folder.add_removal("rigs.bin");
        folder.add_removal("frames.bin");
    }
}

}  // namespace clba::colmap
