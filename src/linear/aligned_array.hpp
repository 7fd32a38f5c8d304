// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <type_traits>

namespace clba {

// Numbers that start on a cache line; 0 at first.
template <class Real>
class AlignedArray {
    static_assert(std::is_trivial_v<Real>);

public:
    void allocate(int64_t size) {
        const auto count = static_cast<std::size_t>(size);
        data_.reset(static_cast<Real*>(::operator new(count * sizeof(Real), alignment)));
        std::uninitialized_value_construct_n(data_.get(), count);
    }
    Real* data() { return data_.get(); }
    const Real* data() const { return data_.get(); }

private:
    static constexpr std::align_val_t alignment{64};
    struct Delete {
        void operator()(Real* data) const { ::operator delete(data, alignment); }
    };
    std::unique_ptr<Real, Delete> data_;
};

}  // namespace clba
