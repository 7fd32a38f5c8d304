// SPDX-License-Identifier: Apache-2.0
#pragma once
// What the opaque handles of clba.h hold, and how every exported function is wrapped.
#include <atomic>
#include <cstddef>
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.hpp"
#include "clba/clba.h"
#include "device/context.hpp"
#include "io/formats.hpp"
#include "linear/device_problem.hpp"
#include "problem/observation_index.hpp"

struct clba_context {
    std::atomic<int> references{1};
    std::shared_ptr<clba::Context> context;
};

struct clba_problem {
    std::atomic<int> references{1};
    clba::Reconstruction reconstruction;
    clba::Problem& problem = reconstruction.problem;
    clba::Format format = clba::Format::automatic;  // of the file it was read from, if it was
    std::string notices;                            // those of the reconstruction, a line each
    // The problem on the device it was last used on; emptied when the structure changes. Keeps its
    // context alive.
    std::unique_ptr<clba::DeviceProblem> mirror;
    // For windows; made by the first, and emptied as the mirror, but extended by appended rows.
    std::unique_ptr<clba::ObservationIndex> index;
};

struct clba_cancellation {
    std::atomic<int> references{1};
    std::atomic<bool> is_requested{false};
    static_assert(std::atomic<bool>::is_always_lock_free, "signal handlers may not lock");
};

struct clba_result {
    clba_summary summary;
    std::vector<clba_iteration> rows;
    std::string report, json;
};

namespace clba {

void set_last_error(std::string_view message, std::string_view more = "") noexcept;

// Runs the body of an exported function and turns what it throws into a status and a message.
template <class Body>
clba_status guarded(Body&& body) noexcept {
    try {
        set_last_error("");
        body();
        return CLBA_OK;
    } catch (const Error& error) {
        set_last_error(error.what());
        return static_cast<clba_status>(error.status());
    } catch (const std::bad_alloc&) {
        set_last_error("out of memory on the host");
        return CLBA_ERROR_OUT_OF_MEMORY;
    } catch (const std::length_error&) {
        set_last_error("out of memory on the host: a size is beyond what can be allocated");
        return CLBA_ERROR_OUT_OF_MEMORY;
    } catch (const std::exception& error) {
        set_last_error("internal error: ", error.what());
        return CLBA_ERROR_INTERNAL;
    } catch (...) {
        set_last_error("internal error");
        return CLBA_ERROR_INTERNAL;
    }
}

template <class Pointer>
void require_pointer(Pointer* pointer, const char* name) {
    require(pointer != nullptr, name, " is NULL, but it must not be");
}

inline void require_count(int64_t count, int64_t expected, const char* rows) {
    require(count == expected, "count = ", count, ", but there are ", expected, " ", rows);
}

inline void require_range(int64_t first, int64_t count, int64_t num_rows, const char* rows) {
    require(first >= 0 && count >= 0 && first <= num_rows - count, "rows [", first, ", ", first,
            " + ", count, ") were asked for, but there are ", num_rows, " ", rows);
}

// What has changed of a problem, and so what of its mirror has to be made again.
enum class Changed {
    state,         // nothing
    scales,        // constants and uncertainties
    measurements,  // observations' values and covariances
    rows_added,    // the mirror, but not the lists of observations
    rigs,          // likewise, and the lists of rigs
    structure      // all
};

inline void note_change(clba_problem& handle, Changed change) {
    if (change == Changed::rows_added) extend_infos(handle.reconstruction);
    if (change == Changed::structure || change == Changed::rows_added || change == Changed::rigs)
        handle.mirror.reset();
    if (change == Changed::structure) handle.index.reset();
    if ((change == Changed::rows_added || change == Changed::rigs) && handle.index) {
        try {
            if (change == Changed::rigs) handle.index->list_rigs(handle.problem);
            handle.index->extend(handle.problem);
        } catch (const std::bad_alloc&) {
            handle.index.reset();
        }
    }
    if (!handle.mirror) return;
    handle.mirror->is_stale.scales |= change == Changed::scales;
    handle.mirror->is_stale.measurements |= change == Changed::measurements;
}

// Runs a change that checks everything before it touches the problem, and returns what it changed:
// nothing says the structure, as true does; false only the state.
template <class Change>
clba_status changed(clba_problem* handle, Change&& change) {
    return guarded([&] {
        require_pointer(handle, "problem");
        using Answer = decltype(change(handle->problem));
        if constexpr (std::is_void_v<Answer>) {
            change(handle->problem);
            note_change(*handle, Changed::structure);
        } else if constexpr (std::is_same_v<Answer, Changed>) {
            note_change(*handle, change(handle->problem));
        } else {
            note_change(*handle, change(handle->problem) ? Changed::structure : Changed::state);
        }
        drop_mismatched(handle->reconstruction);
    });
}

// The caller's struct as this version knows it: what the caller's version lacks has its default,
// and what this version does not know must be 0.
template <class Struct>
Struct copied_in(const Struct* caller, const Struct& defaults, const char* name) {
    if (!caller) return defaults;
    const uint32_t size = caller->struct_size;
    require(size >= sizeof(uint32_t), name, ".struct_size = ", size, ", but it must be sizeof(",
            name, "); fill the struct with its _init function");
    const auto* bytes = reinterpret_cast<const unsigned char*>(caller);
    for (size_t i = sizeof(Struct); i < size; ++i)
        require(bytes[i] == 0, name, " has a field at byte ", i,
                " that this version of the library does not know; leave it 0");
    Struct copy = defaults;
    std::memcpy(&copy, caller, std::min<size_t>(size, sizeof(Struct)));
    return copy;
}

// Fills the caller's struct as far as the caller's version goes.
template <class Struct>
void copy_out(const Struct& value, Struct* caller, const char* name) {
    require_pointer(caller, name);
    const uint32_t size = caller->struct_size;
    require(size >= sizeof(uint32_t), name, ".struct_size = ", size, ", but it must be sizeof(",
            name, ")");
    std::memcpy(caller, &value, std::min<size_t>(size, sizeof(Struct)));
    caller->struct_size = size;
}

// Body of the _init functions.
template <class Struct>
void init_struct(Struct* caller, size_t struct_size, const Struct& defaults, const char* name) {
    require_pointer(caller, name);
    require(struct_size >= sizeof(uint32_t), "struct_size = ", struct_size,
            ", but it must be sizeof(", name, ")");
    std::memset(static_cast<void*>(caller), 0, struct_size);
    std::memcpy(static_cast<void*>(caller), &defaults, std::min(struct_size, sizeof(Struct)));
    caller->struct_size = static_cast<uint32_t>(struct_size);
}

// A text into a field of fixed size, cut if it is too long; the rest of the field is 0.
template <size_t size>
void copy_text(const std::string& from, char (&to)[size]) {
    const size_t length = std::min(from.size(), size - 1);
    std::memcpy(to, from.data(), length);
    std::memset(to + length, 0, size - length);
}

// Rows of a caller's array: a pointer and a stride in bytes, 0 for rows without gaps.
template <class Value>
class Rows {
public:
    Rows(Value* data, size_t stride, size_t values_per_row, const char* name, int64_t count)
        : data_(data), stride_(stride ? stride : values_per_row * sizeof(Value)) {
        if (count > 0) require_pointer(data, name);
        require(stride_ >= values_per_row * sizeof(Value), name, " has a stride of ", stride_,
                " bytes, but a row has ", values_per_row * sizeof(Value));
    }
    // Value k of row i; rows of any alignment.
    std::remove_const_t<Value> get(int64_t i, size_t k = 0) const {
        std::remove_const_t<Value> value;
        std::memcpy(&value, address(i, k), sizeof value);
        return value;
    }
    void set(int64_t i, size_t k, Value value) const {
        std::memcpy(address(i, k), &value, sizeof value);
    }

private:
    auto* address(int64_t i, size_t k) const {
        using Byte = std::conditional_t<std::is_const_v<Value>, const unsigned char, unsigned char>;
        return reinterpret_cast<Byte*>(data_) + static_cast<size_t>(i) * stride_ +
               k * sizeof(Value);
    }
    Value* data_;
    size_t stride_;
};

}  // namespace clba
