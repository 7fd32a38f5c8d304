// SPDX-License-Identifier: Apache-2.0
#include "io/text_input.hpp"

#include <bzlib.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <utility>

#include "base/error.hpp"
#include "io/read_progress.hpp"

namespace clba {
namespace {

constexpr size_t block_bytes = size_t{1} << 16;

// The file as it is on disk, one block at a time.
class RawFile {
public:
    explicit RawFile(const std::string& path)
        : path_(path), file_(std::fopen(path.c_str(), "rb")), block_(block_bytes) {
        if (!file_) fail(Status::file, "cannot open ", path_, ": ", std::strerror(errno));
        std::setvbuf(file_, nullptr, _IONBF, 0);
    }
    ~RawFile() {
        if (file_) std::fclose(file_);
    }
    RawFile(RawFile&& other) noexcept
        : path_(std::move(other.path_)),
          file_(std::exchange(other.file_, nullptr)),
          block_(std::move(other.block_)),
          pending_(other.pending_) {}

    // Bytes read and not consumed, after reading more if there were none; empty at the end.
    std::string_view pending() {
        if (pending_.empty()) {
            const size_t count = std::fread(block_.data(), 1, block_.size(), file_);
            if (std::ferror(file_))
                fail(Status::file, "cannot read ", path_, ": ", std::strerror(errno));
            pending_ = {block_.data(), count};
            ReadProgress::add(static_cast<int64_t>(count));
        }
        return pending_;
    }
    void consume(size_t count) { pending_.remove_prefix(count); }
    const std::string& path() const { return path_; }

private:
    std::string path_;
    std::FILE* file_;
    std::vector<char> block_;
    std::string_view pending_;
};

[[noreturn]] void fail_truncated(const RawFile& file, const char* format) {
    fail(Status::format, file.path(), ": its ", format,
         " data end early; the file is truncated, fetch or write it again");
}

[[noreturn]] void fail_damaged(const RawFile& file, const char* format, const char* reason) {
    fail(Status::format, file.path(), ": its ", format, " data are damaged: ", reason);
}

class PlainSource final : public ByteSource {
public:
    explicit PlainSource(RawFile file) : file_(std::move(file)) {}
    size_t read(char* bytes, size_t size) override {
        size_t count = 0;
        while (count < size) {
            const std::string_view pending = file_.pending();
            if (pending.empty()) break;
            const size_t part = std::min(pending.size(), size - count);
            std::memcpy(bytes + count, pending.data(), part);
            file_.consume(part);
            count += part;
        }
        return count;
    }

private:
    RawFile file_;
};

class GzipSource final : public ByteSource {
public:
    explicit GzipSource(RawFile file) : file_(std::move(file)) {
        if (inflateInit2(&stream_, 15 + 16) != Z_OK)  // largest window, gzip header
            fail(Status::out_of_memory, "no memory to decompress ", file_.path());
    }
    ~GzipSource() override { inflateEnd(&stream_); }
    GzipSource(const GzipSource&) = delete;
    GzipSource& operator=(const GzipSource&) = delete;

    size_t read(char* bytes, size_t size) override {
        stream_.next_out = reinterpret_cast<Bytef*>(bytes);
        stream_.avail_out = static_cast<uInt>(size);
        while (stream_.avail_out > 0) {
            const std::string_view input = file_.pending();
            if (!inside_member_) {
                if (input.empty()) break;
                inflateReset(&stream_);
                inside_member_ = true;
            }
            stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(input.data()));
            stream_.avail_in = static_cast<uInt>(input.size());
            const int code = inflate(&stream_, Z_NO_FLUSH);
            file_.consume(input.size() - stream_.avail_in);
            if (code == Z_STREAM_END) {
                inside_member_ = false;
            } else if (code == Z_BUF_ERROR && input.empty()) {
                fail_truncated(file_, "gzip");
            } else if (code != Z_OK && code != Z_BUF_ERROR) {
                fail_damaged(file_, "gzip", stream_.msg ? stream_.msg : zError(code));
            }
        }
        return size - stream_.avail_out;
    }

private:
    RawFile file_;
    z_stream stream_{};
    bool inside_member_ = false;
};

class Bzip2Source final : public ByteSource {
public:
    explicit Bzip2Source(RawFile file) : file_(std::move(file)) {}
    ~Bzip2Source() override { end_stream(); }
    Bzip2Source(const Bzip2Source&) = delete;
    Bzip2Source& operator=(const Bzip2Source&) = delete;

    size_t read(char* bytes, size_t size) override {
        size_t count = 0;
        while (count < size) {
            const std::string_view input = file_.pending();
            if (!inside_stream_) {
                if (input.empty()) break;
                begin_stream();
            }
            stream_.next_in = const_cast<char*>(input.data());
            stream_.avail_in = static_cast<unsigned>(input.size());
            stream_.next_out = bytes + count;
            stream_.avail_out = static_cast<unsigned>(size - count);
            const int code = BZ2_bzDecompress(&stream_);
            file_.consume(input.size() - stream_.avail_in);
            const size_t before = count;
            count = size - stream_.avail_out;
            if (code == BZ_STREAM_END) {
                end_stream();
            } else if (code == BZ_MEM_ERROR) {
                fail(Status::out_of_memory, "no memory to decompress ", file_.path());
            } else if (code != BZ_OK) {
                fail_damaged(file_, "bzip2",
                             code == BZ_DATA_ERROR_MAGIC ? "no bzip2 header where one must be"
                                                         : "a checksum or code is wrong");
            } else if (input.empty() && count == before) {
                fail_truncated(file_, "bzip2");
            }
        }
        return count;
    }

private:
    void begin_stream() {
        stream_ = {};
        if (BZ2_bzDecompressInit(&stream_, 0, 0) != BZ_OK)
            fail(Status::out_of_memory, "no memory to decompress ", file_.path());
        inside_stream_ = true;
    }
    void end_stream() {
        if (inside_stream_) BZ2_bzDecompressEnd(&stream_);
        inside_stream_ = false;
    }

    RawFile file_;
    bz_stream stream_{};
    bool inside_stream_ = false;
};

bool begins_with(std::string_view bytes, std::string_view magic) {
    return bytes.substr(0, magic.size()) == magic;
}

void append_all(ByteSource& source, std::string& text) {
    std::vector<char> block(block_bytes);
    while (const size_t count = source.read(block.data(), block.size()))
        text.append(block.data(), count);
}

}  // namespace

std::unique_ptr<ByteSource> open_input(const std::string& path) {
    RawFile file(path);
    const std::string_view start = file.pending();
    if (begins_with(start, "\x1f\x8b")) return std::make_unique<GzipSource>(std::move(file));
    if (begins_with(start, "BZh")) return std::make_unique<Bzip2Source>(std::move(file));
    return std::make_unique<PlainSource>(std::move(file));
}

TokenReader::TokenReader(const std::string& path)
    : path_(path), source_(open_input(path)), block_(block_bytes) {}

bool TokenReader::refill() {
    const size_t rest = end_ - begin_;
    if (rest == block_.size())
        fail(Status::format, path_, ":", line_, ": a word of more than ", rest,
             " bytes; this is not a text of numbers");
    std::memmove(block_.data(), block_.data() + begin_, rest);
    begin_ = 0;
    end_ = rest + source_->read(block_.data() + rest, block_.size() - rest);
    return end_ > rest;
}

std::string_view TokenReader::next() {
    for (;;) {
        while (begin_ < end_ && is_space(block_[begin_])) line_ += block_[begin_++] == '\n';
        if (begin_ < end_) break;
        if (!refill()) return {};
    }
    size_t stop = begin_;
    for (;;) {
        while (stop < end_ && !is_space(block_[stop])) ++stop;
        if (stop < end_) break;
        const size_t length = stop - begin_;
        const bool more = refill();
        stop = begin_ + length;
        if (!more) break;
    }
    const std::string_view token(block_.data() + begin_, stop - begin_);
    begin_ = stop;
    token_line_ = line_;
    return token;
}

std::string TokenReader::rest() {
    std::string text(block_.data() + begin_, end_ - begin_);
    begin_ = end_;
    append_all(*source_, text);
    return text;
}

LineReader::LineReader(const std::string& path)
    : path_(path), source_(open_input(path)), block_(block_bytes) {}

bool LineReader::next(std::string_view& line) {
    size_t searched = begin_;
    for (;;) {
        const void* const found = std::memchr(block_.data() + searched, '\n', end_ - searched);
        if (found) {
            const size_t stop =
                static_cast<size_t>(static_cast<const char*>(found) - block_.data());
            line = {block_.data() + begin_, stop - begin_};
            begin_ = stop + 1;
            break;
        }
        const size_t rest = end_ - begin_;
        if (rest == block_.size())
            fail(Status::format, path_, ":", line_ + 1, ": a line of more than ", rest, " bytes");
        std::memmove(block_.data(), block_.data() + begin_, rest);
        begin_ = 0;
        searched = rest;
        end_ = rest + source_->read(block_.data() + rest, block_.size() - rest);
        if (end_ > rest) continue;
        if (rest == 0) return false;
        line = {block_.data(), rest};
        begin_ = rest;
        break;
    }
    ++line_;
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    return true;
}

std::string read_text(const std::string& path) {
    std::string text;
    append_all(*open_input(path), text);
    return text;
}

std::string shown(std::string_view token) {
    constexpr size_t most = 40;
    std::string characters(token.substr(0, most));
    for (char& c : characters)
        if (c < ' ' || c > '~') c = '?';
    return token.size() > most ? characters + "..." : characters;
}

}  // namespace clba
