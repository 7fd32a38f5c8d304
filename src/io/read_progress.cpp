// SPDX-License-Identifier: Apache-2.0
#include "io/read_progress.hpp"

#include <algorithm>

#include "base/error.hpp"

namespace clba {
namespace {

thread_local ReadProgress* current = nullptr;

}  // namespace

ReadProgress::ReadProgress(int64_t bytes, std::function<bool(double)> on_progress)
    : bytes_(std::max<int64_t>(bytes, 1)), on_progress_(std::move(on_progress)) {
    current = this;
}

ReadProgress::~ReadProgress() {
    current = nullptr;
}

void ReadProgress::add(int64_t bytes) {
    if (!current) return;
    ReadProgress& it = *current;
    it.read_ = std::min(it.read_ + bytes, it.bytes_);
    if (it.read_ < it.next_report_) return;
    it.next_report_ = it.read_ + std::max<int64_t>(it.bytes_ / 100, 1);
    if (it.on_progress_(static_cast<double>(it.read_) / static_cast<double>(it.bytes_)))
        fail(Status::cancelled, "reading was stopped by the progress callback");
}

}  // namespace clba
