// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <cstdint>
#include <functional>

namespace clba {

// Passes on how much of a file has been read. The one that lives on a thread is told by readers
// on that thread; where there is none they tell nobody.
class ReadProgress {
public:
    // on_progress(share read, from 0 to 1), at most once a hundredth; true: stop reading. bytes: of
    // all that will be read.
    ReadProgress(int64_t bytes, std::function<bool(double)> on_progress);
    ~ReadProgress();
    ReadProgress(const ReadProgress&) = delete;
    ReadProgress& operator=(const ReadProgress&) = delete;

    // So many more bytes have been read. Throws Status::cancelled if on_progress said so.
    static void add(int64_t bytes);

private:
    int64_t bytes_, read_ = 0, next_report_ = 0;
    std::function<bool(double)> on_progress_;
};

}  // namespace clba
