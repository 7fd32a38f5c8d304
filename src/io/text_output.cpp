// SPDX-License-Identifier: Apache-2.0
#include "io/text_output.hpp"

#include <bzlib.h>
#include <zlib.h>

#include <charconv>
#include <vector>

#include "base/error.hpp"

namespace clba {

class Compressor {
public:
    virtual ~Compressor() = default;
    // Compresses a block of less than 4 GiB into the file; the last one ends the stream.
    virtual void write(std::string_view block, bool is_last, AtomicFile& file) = 0;
};

namespace {

constexpr size_t block_bytes = size_t{1} << 16;

class GzipCompressor final : public Compressor {
public:
    GzipCompressor() : output_(block_bytes) {
        constexpr int largest_window_gzip_header = 15 + 16, default_memory_level = 8;
        if (deflateInit2(&stream_, Z_DEFAULT_COMPRESSION, Z_DEFLATED, largest_window_gzip_header,
                         default_memory_level, Z_DEFAULT_STRATEGY) != Z_OK)
            fail(Status::out_of_memory, "no memory to compress with gzip");
    }
    ~GzipCompressor() override { deflateEnd(&stream_); }
    GzipCompressor(const GzipCompressor&) = delete;
    GzipCompressor& operator=(const GzipCompressor&) = delete;

    void write(std::string_view block, bool is_last, AtomicFile& file) override {
        stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(block.data()));
        stream_.avail_in = static_cast<uInt>(block.size());
        do {
            stream_.next_out = reinterpret_cast<Bytef*>(output_.data());
            stream_.avail_out = static_cast<uInt>(output_.size());
            const int code = deflate(&stream_, is_last ? Z_FINISH : Z_NO_FLUSH);
            if (code == Z_STREAM_ERROR) fail(Status::internal, "deflate: ", zError(code));
            file.write({output_.data(), output_.size() - stream_.avail_out});
        } while (stream_.avail_out == 0);
    }

private:
    z_stream stream_{};
    std::vector<char> output_;
};

class Bzip2Compressor final : public Compressor {
public:
    Bzip2Compressor() : output_(block_bytes) {
        constexpr int hundreds_of_kilobytes = 9;
        if (BZ2_bzCompressInit(&stream_, hundreds_of_kilobytes, 0, 0) != BZ_OK)
            fail(Status::out_of_memory, "no memory to compress with bzip2");
    }
    ~Bzip2Compressor() override { BZ2_bzCompressEnd(&stream_); }
    Bzip2Compressor(const Bzip2Compressor&) = delete;
    Bzip2Compressor& operator=(const Bzip2Compressor&) = delete;

    void write(std::string_view block, bool is_last, AtomicFile& file) override {
        stream_.next_in = const_cast<char*>(block.data());
        stream_.avail_in = static_cast<unsigned>(block.size());
        bool is_done = false;
        while (!is_done) {
            stream_.next_out = output_.data();
            stream_.avail_out = static_cast<unsigned>(output_.size());
            const int code = BZ2_bzCompress(&stream_, is_last ? BZ_FINISH : BZ_RUN);
            if (code < 0) fail(Status::internal, "BZ2_bzCompress: error ", code);
            file.write({output_.data(), output_.size() - stream_.avail_out});
            is_done = is_last ? code == BZ_STREAM_END : stream_.avail_in == 0;
        }
    }

private:
    bz_stream stream_{};
    std::vector<char> output_;
};

bool ends_with(std::string_view name, std::string_view ending) {
    return name.size() >= ending.size() && name.substr(name.size() - ending.size()) == ending;
}

std::unique_ptr<Compressor> compressor_for(std::string_view path) {
    if (ends_with(path, ".gz")) return std::make_unique<GzipCompressor>();
    if (ends_with(path, ".bz2")) return std::make_unique<Bzip2Compressor>();
    return nullptr;
}

}  // namespace

TextOutput::TextOutput(const std::string& path) : file_(path), compressor_(compressor_for(path)) {
    block_.reserve(block_bytes);
}

TextOutput::~TextOutput() = default;

void TextOutput::put(std::string_view characters) {
    block_ += characters;
    if (block_.size() >= block_bytes) flush_block();
}

void TextOutput::put(int64_t value) {
    char digits[24];
    const auto end = std::to_chars(digits, digits + sizeof digits, value).ptr;
    put(std::string_view(digits, static_cast<size_t>(end - digits)));
}

void TextOutput::put(double value) {
    char digits[32];
    const auto end = std::to_chars(digits, digits + sizeof digits, value).ptr;
    put(std::string_view(digits, static_cast<size_t>(end - digits)));
}

void TextOutput::flush_block() {
    if (compressor_)
        compressor_->write(block_, false, file_);
    else
        file_.write(block_);
    block_.clear();
}

void TextOutput::commit() {
    if (compressor_)
        compressor_->write(block_, true, file_);
    else
        file_.write(block_);
    block_.clear();
    file_.commit();
}

}  // namespace clba
