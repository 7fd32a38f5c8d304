// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

struct _cl_mem;

namespace clba {

class Queue;

// Device bytes held by one queue's buffers.
struct MemoryAccount {
    uint64_t current_bytes = 0;
    uint64_t peak_bytes = 0;
    void reset_peak() { peak_bytes = current_bytes; }
};

// Device memory. Moves, does not copy; must not outlive its queue.
class Buffer {
public:
    Buffer() = default;
    // label says what it is for, in the error when there is not enough memory. 0 bytes are allowed.
    Buffer(Queue& queue, uint64_t bytes, const std::string& label);
    // What `values` hold.
    template <class Value>
    Buffer(Queue& queue, const std::vector<Value>& values, const std::string& label)
        : Buffer(queue, values.size() * sizeof(Value), label) {
        write(values.data(), bytes_);
    }
    Buffer(Buffer&& other) noexcept { swap(other); }
    Buffer& operator=(Buffer&& other) noexcept {
        Buffer(std::move(other)).swap(*this);
        return *this;
    }
    ~Buffer();

    uint64_t bytes() const { return bytes_; }
    _cl_mem* handle() const { return handle_; }
    explicit operator bool() const { return handle_ != nullptr; }
    void swap(Buffer& other) noexcept {
        std::swap(queue_, other.queue_);
        std::swap(handle_, other.handle_);
        std::swap(bytes_, other.bytes_);
        std::swap(memory_, other.memory_);
    }

    void fill_zero();
    void copy_from(const Buffer& source);  // of equal size
    void write(const void* data, uint64_t bytes);
    void read(void* data, uint64_t bytes) const;

    // Maps the whole buffer for the lifetime of the result. Where the device shares the host's
    // memory nothing is copied.
    enum class Access { read, write, update };
    template <class Value>
    class Mapping;
    template <class Value>
    Mapping<const Value> map_read() const {
        return Mapping<const Value>(*this, map(Access::read));
    }
    template <class Value>
    Mapping<Value> map_write() {
        return Mapping<Value>(*this, map(Access::write));
    }
    template <class Value>
    Mapping<Value> map_update() {  // to read and write
        return Mapping<Value>(*this, map(Access::update));
    }

private:
    void* map(Access access) const;
    void unmap(void* address) const;

    Queue* queue_ = nullptr;
    _cl_mem* handle_ = nullptr;
    uint64_t bytes_ = 0;
    std::shared_ptr<MemoryAccount> memory_;
};

template <class Value>
class Buffer::Mapping {
public:
    Mapping(const Buffer& buffer, void* address) : buffer_(buffer), address_(address) {}
    ~Mapping() { buffer_.unmap(address_); }
    Mapping(const Mapping&) = delete;
    Mapping& operator=(const Mapping&) = delete;
    Value* data() const { return static_cast<Value*>(address_); }
    Value& operator[](int64_t i) const { return data()[i]; }

private:
    const Buffer& buffer_;
    void* address_;
};

}  // namespace clba
