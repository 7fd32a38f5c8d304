// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "device/buffer.hpp"
#include "device/context.hpp"

struct _cl_event;
struct _cl_kernel;

namespace clba {

// What a launch is accounted to: the steps of the paper's Table 1, and the rest.
enum class Step : int { residual, jacobian, preconditioner, jx, jty, schur, vector };
inline constexpr int num_steps = 7;

// A kernel of a program, compiled for its options. Belongs to one Queue.
struct Kernel {
    _cl_kernel* handle = nullptr;
    std::string name;
};

// Bytes of local memory for a kernel's scratch argument.
struct Scratch {
    size_t bytes = 0;
};

// An in-order command queue with its kernels, its memory account and its clock. Used by one thread
// at a time; every blocking call waits for all that came before it.
class Queue {
public:
    explicit Queue(std::shared_ptr<Context> context);
    ~Queue();
    Queue(const Queue&) = delete;
    Queue& operator=(const Queue&) = delete;

    Context& context() const { return *context_; }
    const Tuning& tuning() const { return context_->tuning; }

    // defines: "-DNAME=value ..." beyond those of the tuning. Kernels are kept by name and defines.
    Kernel& kernel(const std::string& path, const std::string& name, const std::string& defines,
                   const std::string& camera_model_path = "");

    // double arguments are passed as floats from now on: for kernels that know no double.
    void pass_floats() { passes_floats_ = true; }

    // Runs `groups` work-groups of the tuned size; none for 0. Buffers, scalars and Scratch are
    // passed in the kernel's order; a nullptr Buffer* passes NULL.
    template <class... Arguments>
    void launch(Step step, Kernel& kernel, int64_t groups, const Arguments&... arguments) {
        if (groups == 0) return;
        unsigned index = 0;
        (set_argument(kernel, index++, arguments), ...);
        enqueue(step, kernel, groups);
    }

    Scratch scratch() const {
        return {static_cast<size_t>(tuning().work_group_size) * sizeof(double)};
    }

    void finish();
    // Seconds on the device by step since the last reset; waits for the queue.
    std::array<double, num_steps> step_seconds();
    void reset_step_seconds();

    MemoryAccount& memory() { return *memory_; }
    const std::shared_ptr<MemoryAccount>& memory_account() const { return memory_; }
    _cl_command_queue* handle() const { return queue_; }

private:
    void set_argument(Kernel& kernel, unsigned index, const Buffer& buffer);
    void set_argument(Kernel& kernel, unsigned index, const Buffer* buffer);
    void set_argument(Kernel& kernel, unsigned index, const Scratch& scratch);
    void set_argument(Kernel& kernel, unsigned index, int32_t value);
    void set_argument(Kernel& kernel, unsigned index, double value);
    void set_bytes(Kernel& kernel, unsigned index, size_t bytes, const void* value);
    void enqueue(Step step, Kernel& kernel, int64_t groups);
    void collect_events();

    std::shared_ptr<Context> context_;
    std::shared_ptr<MemoryAccount> memory_;
    _cl_command_queue* queue_ = nullptr;
    bool has_profiling_ = false;
    bool passes_floats_ = false;
    std::map<std::string, Kernel> kernels_;
    std::vector<std::pair<Step, _cl_event*>> events_;
    std::array<double, num_steps> step_seconds_{};
};

}  // namespace clba
