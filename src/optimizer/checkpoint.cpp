// SPDX-License-Identifier: Apache-2.0
#include "optimizer/checkpoint.hpp"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>

#include "base/atomic_file.hpp"
#include "base/error.hpp"
#include "base/hash.hpp"

namespace clba {
namespace {

constexpr char magic[] = {'C', 'L', 'B', 'A', 'C', 'K', 'P', 'T'};
constexpr uint64_t version = 1;
constexpr size_t word_bytes = 8;

// A file is a sequence of little-endian words of 8 bytes. One description, `visit`, serves writer
// and reader.
class Writer {
public:
    template <class Value>
    void operator()(const Value& value) {
        uint64_t word = 0;
        if constexpr (std::is_floating_point_v<Value>)
            std::memcpy(&word, &value, sizeof word);
        else
            word = static_cast<uint64_t>(static_cast<int64_t>(value));
        for (size_t k = 0; k < word_bytes; ++k)
            bytes_.push_back(static_cast<char>(word >> (8 * k) & 0xff));
    }
    void size(size_t value) { (*this)(static_cast<int64_t>(value)); }
    template <class Row>
    size_t rows(const std::vector<Row>& values) {
        size(values.size());
        return values.size();
    }
    void append(std::string_view text) { bytes_.append(text); }
    const std::string& bytes() const { return bytes_; }

private:
    std::string bytes_;
};

class Reader {
public:
    Reader(const std::string& bytes, const std::string& path) : bytes_(bytes), path_(path) {}

    template <class Value>
    void operator()(Value& value) {
        const uint64_t word = next();
        if constexpr (std::is_floating_point_v<Value>)
            std::memcpy(&value, &word, sizeof word);
        else
            value = static_cast<Value>(static_cast<int64_t>(word));
    }
    template <class Row>
    size_t rows(std::vector<Row>& values) {
        const uint64_t count = next();
        if (count > (bytes_.size() - at_) / word_bytes) damaged();
        values.resize(count);
        return count;
    }
    void skip(size_t bytes) { at_ += bytes; }
    void expect_end() {
        if (at_ != bytes_.size()) damaged();
    }
    [[noreturn]] void damaged() {
        fail(Status::format, path_, ": the checkpoint is damaged or cut off; use another one");
    }

private:
    uint64_t next() {
        if (at_ + word_bytes > bytes_.size()) damaged();
        uint64_t word = 0;
        for (size_t k = 0; k < word_bytes; ++k)
            word |= uint64_t{static_cast<unsigned char>(bytes_[at_ + k])} << (8 * k);
        at_ += word_bytes;
        return word;
    }

    const std::string& bytes_;
    const std::string& path_;
    size_t at_ = 0;
};

template <class Access, class Key>
void visit_key(Access& access, Key& key) {
    access(key.fingerprint);
    access(key.linear_solver);
    access(key.preconditioner);
    access(key.damping);
    access(key.precision);
    access(key.jacobian);
}

template <class Access, class Row>
void visit_row(Access& access, Row& row) {
    access(row.iteration);
    access(row.step_is_accepted);
    access(row.step_is_valid);
    access(row.linear_solver_iterations);
    access(row.num_behind);
    access(row.cost);
    access(row.cost_change);
    access(row.gradient_max_norm);
    access(row.step_norm);
    access(row.gain_ratio);
    access(row.trust_region_radius);
    access(row.seconds);
    access(row.remaining_iterations);
    access(row.remaining_seconds);
}

template <class Access, class Values>
void visit_values(Access& access, Values& values) {
    const size_t count = access.rows(values);
    for (size_t i = 0; i < count; ++i) access(values[i]);
}

template <class Access, class Data>
void visit(Access& access, Data& data) {
    access(data.radius);
    access(data.shrink_factor);
    access(data.linear_solver.num_steps);
    access(data.linear_solver.break_even);
    access(data.linear_solver.is_explicit);
    access(data.linear_solver.explicit_lambda);
    access(data.linear_solver.explicit_step);
    access(data.linear_solver.explicit_iterations);
    access(data.consecutive_invalid_steps);
    access(data.model_decrease);
    const size_t num_rows = access.rows(data.rows);
    for (size_t i = 0; i < num_rows; ++i) visit_row(access, data.rows[i]);
    access(data.num_accepted_steps);
    access(data.num_rejected_steps);
    access(data.num_invalid_steps);
    access(data.num_linear_solver_iterations);
    access(data.num_behind_initial);
    access(data.num_indefinite_blocks);
    access(data.initial_cost);
    visit_values(access, data.state);
    visit_values(access, data.fixed_damping);
}

std::string read_file(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::string bytes;
    if (file) bytes.assign(std::istreambuf_iterator<char>(file), {});
    if (!file || file.bad()) fail(Status::file, "cannot read ", path, ": ", std::strerror(errno));
    return bytes;
}

}  // namespace

void write_checkpoint(const Checkpoint& checkpoint, const std::string& path) {
    Writer writer;
    writer.append({magic, sizeof magic});
    writer(version);
    visit_key(writer, checkpoint.key);
    visit(writer, checkpoint);
    Hash hash;
    hash.add_bytes(writer.bytes());
    writer(hash.value());
    AtomicFile file(path);
    file.write(writer.bytes());
    file.commit();
}

Checkpoint read_checkpoint(const std::string& path, const CheckpointKey& expected) {
    const std::string bytes = read_file(path);
    Reader reader(bytes, path);
    if (bytes.compare(0, sizeof magic, magic, sizeof magic) != 0)
        fail(Status::format, path,
             ": this is no checkpoint of clba; it does not begin with CLBACKPT");
    reader.skip(sizeof magic);
    uint64_t found_version = 0;
    reader(found_version);
    if (found_version != version)
        fail(Status::format, path, ": the checkpoint has version ", found_version,
             ", but this library reads version ", version, "; use the library that wrote it");
    Hash hash;
    hash.add_bytes(std::string_view(bytes).substr(0, bytes.size() - word_bytes));
    Reader end(bytes, path);
    end.skip(bytes.size() - word_bytes);
    uint64_t checksum = 0;
    end(checksum);
    if (checksum != hash.value()) reader.damaged();

    Checkpoint checkpoint;
    visit_key(reader, checkpoint.key);
    const auto require_same = [&](bool same, const char* what, const char* remedy) {
        require(same, path, ": the checkpoint is of ", what, "; ", remedy);
    };
    const CheckpointKey& key = checkpoint.key;
    require_same(
        key.fingerprint == expected.fingerprint, "another problem",
        "observations, weights, constants and loss must be those of the solve that wrote it");
    constexpr const char* same_option = "give the option that the solve that wrote it had";
    require_same(key.linear_solver == expected.linear_solver, "another linear_solver", same_option);
    require_same(key.preconditioner == expected.preconditioner, "another preconditioner",
                 same_option);
    require_same(key.damping == expected.damping, "another damping", same_option);
    require_same(key.precision == expected.precision, "another precision", same_option);
    require_same(key.jacobian == expected.jacobian, "another jacobian", same_option);
    visit(reader, checkpoint);
    reader.skip(word_bytes);
    reader.expect_end();
    if (checkpoint.rows.empty()) reader.damaged();
    return checkpoint;
}

}  // namespace clba
