// SPDX-License-Identifier: Apache-2.0
// Devices, contexts, the kernel cache, buffers and queues.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <thread>

#include "device/buffer.hpp"
#include "device/context.hpp"
#include "device/device_info.hpp"
#include "device/opencl.hpp"
#include "device/program_cache.hpp"
#include "device/queue.hpp"
#include "temporary_folder.hpp"

namespace clba::test {
namespace {

std::string upper(std::string value) {
    for (char& c : value) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    return value;
}

TEST(Devices, AreDescribed) {
    const std::vector<DeviceInfo> devices = list_devices();
    ASSERT_FALSE(devices.empty());
    for (size_t i = 0; i < devices.size(); ++i) {
        EXPECT_EQ(devices[i].index, static_cast<int>(i));
        const DeviceInfo again = describe_device(devices[i].id);
        EXPECT_EQ(again.index, -1);
        EXPECT_EQ(again.name, devices[i].name);
        EXPECT_EQ(again.driver, devices[i].driver);
        EXPECT_GT(again.max_work_group_size, 0u);
        EXPECT_GT(again.max_allocation_bytes, 0u);
    }
}

TEST(Devices, AreSelected) {
    const std::vector<DeviceInfo> devices = list_devices();
    for (const DeviceInfo& device : devices) {
        EXPECT_EQ(select_device(device.index, "").id, device.id);
        EXPECT_EQ(select_device(-1, std::to_string(device.index)).id, device.id);
        // The first whose name or platform has the text.
        const std::string part = upper(device.name.substr(device.name.size() / 3));
        const DeviceInfo found = select_device(-1, part);
        EXPECT_LE(found.index, device.index);
        EXPECT_TRUE(upper(found.name).find(part) != std::string::npos ||
                    upper(found.platform).find(part) != std::string::npos);
        EXPECT_NE(
            upper(select_device(-1, upper(device.platform)).platform).find(upper(device.platform)),
            std::string::npos);
    }
    // An index wins over a name.
    EXPECT_EQ(select_device(0, "no such device").id, devices[0].id);
    const DeviceInfo best = select_device(-1, "");
    const bool has_gpu = std::any_of(devices.begin(), devices.end(), [](const DeviceInfo& device) {
        return device.type == DeviceType::gpu;
    });
    EXPECT_EQ(best.type == DeviceType::gpu, has_gpu);
}

TEST(Devices, ThatAreNotThere) {
    const std::string name = list_devices()[0].name;
    EXPECT_TRUE(
        throws([] { select_device(999, ""); }, Status::no_device, {"999", "0: ", name.c_str()}));
    EXPECT_TRUE(throws([] { select_device(-1, "999"); }, Status::no_device, {"999", "0: "}));
    EXPECT_TRUE(throws([] { select_device(-1, "no such device"); }, Status::no_device,
                       {"'no such device'", "0: ", name.c_str()}));
}

TEST(OpenClErrors, HaveNamesAndStatuses) {
    EXPECT_STREQ(opencl_error_name(CL_INVALID_KERNEL_ARGS), "CL_INVALID_KERNEL_ARGS");
    EXPECT_STREQ(opencl_error_name(-12345), "unknown OpenCL error");
    EXPECT_NO_THROW(check_opencl(CL_SUCCESS, "clFinish"));
    EXPECT_TRUE(throws([] { check_opencl(CL_OUT_OF_RESOURCES, "clFinish", "a test"); },
                       Status::out_of_memory, {"clFinish", "CL_OUT_OF_RESOURCES", "a test"}));
    EXPECT_TRUE(throws([] { check_opencl(-12345, "clFinish"); }, Status::device, {"-12345"}));
}

// What a caller of the library may have: a context, a device and a queue of its own.
class CallersOpenCl {
public:
    explicit CallersOpenCl(cl_command_queue_properties properties) {
        device = select_device(-1, "").id;
        cl_int error = CL_SUCCESS;
        context = opencl().clCreateContext(nullptr, 1, &device, nullptr, nullptr, &error);
        check_opencl(error, "clCreateContext");
        queue = opencl().clCreateCommandQueue(context, device, properties, &error);
        check_opencl(error, "clCreateCommandQueue");
    }
    ~CallersOpenCl() {
        opencl().clReleaseCommandQueue(queue);
        opencl().clReleaseContext(context);
    }
    ContextOptions options() const {
        ContextOptions options;
        options.cl_context = context;
        options.cl_device = device;
        options.cl_queue = queue;
        return options;
    }
    cl_uint references() const {
        cl_uint count = 0;
        opencl().clGetContextInfo(context, CL_CONTEXT_REFERENCE_COUNT, sizeof count, &count,
                                  nullptr);
        return count;
    }

    cl_device_id device = nullptr;
    cl_context context = nullptr;
    cl_command_queue queue = nullptr;
};

void launch_something(Queue& queue) {
    Buffer x(queue, 64 * sizeof(double), "x"), y(queue, 64 * sizeof(double), "y");
    x.fill_zero();
    y.fill_zero();
    queue.launch(Step::vector, queue.kernel("vector.cl", "scale_and_add", "-DREAL=double"), 1, 64,
                 1.0, x, 1.0, y);
}

TEST(Contexts, OfTheCaller) {
    const CallersOpenCl callers(CL_QUEUE_PROFILING_ENABLE);
    const cl_uint references = callers.references();
    {
        const auto context = std::make_shared<Context>(callers.options());
        EXPECT_GT(callers.references(), references);
        EXPECT_EQ(context->cl_context(), callers.context);
        Queue queue(context);
        EXPECT_EQ(queue.handle(), callers.queue);
        launch_something(queue);
        EXPECT_GT(queue.step_seconds()[static_cast<size_t>(Step::vector)], 0);
        queue.reset_step_seconds();
        EXPECT_EQ(queue.step_seconds()[static_cast<size_t>(Step::vector)], 0);
    }
    EXPECT_EQ(callers.references(), references);
}

TEST(Contexts, OfTheCallerWithoutProfiling) {
    const CallersOpenCl callers(0);
    Queue queue(std::make_shared<Context>(callers.options()));
    launch_something(queue);
    for (double seconds : queue.step_seconds()) EXPECT_EQ(seconds, 0);
}

TEST(Contexts, OfTheCallerWithAQueueThatIsOutOfOrder) {
    const CallersOpenCl callers(CL_QUEUE_OUT_OF_ORDER_EXEC_MODE_ENABLE);
    const cl_uint references = callers.references();
    EXPECT_TRUE(throws([&] { Queue queue(std::make_shared<Context>(callers.options())); },
                       Status::invalid_argument, {"out of order", "in-order"}));
    EXPECT_EQ(callers.references(), references);
}

TEST(Contexts, NeedAllThreeOfTheCallersOrNone) {
    const CallersOpenCl callers(0);
    for (int missing = 0; missing < 3; ++missing) {
        ContextOptions options = callers.options();
        if (missing == 0) options.cl_context = nullptr;
        if (missing == 1) options.cl_device = nullptr;
        if (missing == 2) options.cl_queue = nullptr;
        EXPECT_TRUE(
            throws([&] { Context context(options); }, Status::invalid_argument, {"all three"}));
    }
}

TEST(Contexts, ReportWhatTheCompilerSays) {
    const auto context = std::make_shared<Context>(ContextOptions());
    EXPECT_TRUE(throws([&] { context->program("vector.cl", "", "-DREAL=nonsense"); },
                       Status::kernel_build, {"-DREAL=nonsense", "nonsense"}));
    Queue queue(context);
    EXPECT_TRUE(throws([&] { queue.kernel("vector.cl", "no_such_kernel", "-DREAL=double"); },
                       Status::device, {"clCreateKernel", "no_such_kernel"}));
    // Neither stands in the way of what is right.
    launch_something(queue);
    EXPECT_TRUE(
        throws([&] { context->program("absent.cl", "", ""); }, Status::internal, {"absent.cl"}));
}

TEST(Contexts, KeepTheirPrograms) {
    Context context{ContextOptions()};
    _cl_program* const first = context.program("vector.cl", "", "-cl-std=CL1.2 -DREAL=double");
    EXPECT_EQ(context.program("vector.cl", "", "-cl-std=CL1.2 -DREAL=double"), first);
    EXPECT_NE(context.program("vector.cl", "", "-cl-std=CL1.2 -DREAL=float"), first);
}

const std::string key = "0.1.0\n-DREAL=double\nplatform\ndriver 1\nsource";
const std::vector<unsigned char> binary = {0, 1, 2, 255, 4, 5, 6, 7};

TEST(ProgramCache, KeepsWhatIsStored) {
    const TemporaryFolder folder;
    const ProgramCache cache(folder.path("a/b"));  // made on the way
    EXPECT_TRUE(cache.load(key).empty());
    cache.store(key, binary);
    EXPECT_EQ(cache.load(key), binary);
    cache.store(key, {9});
    EXPECT_EQ(cache.load(key), std::vector<unsigned char>{9});
    for (const char* other : {"0.1.0\n-DREAL=double\nplatform\ndriver 2\nsource", ""})
        EXPECT_TRUE(cache.load(other).empty());
}

TEST(ProgramCache, TakesNoFileThatIsNotWhole) {
    const TemporaryFolder folder;
    const ProgramCache cache(folder.path("cache"));
    cache.store(key, binary);
    const std::string whole = content_of(cache.path(key));
    const auto with_file = [&](const std::string& content) {
        std::ofstream(cache.path(key), std::ios::binary) << content;
        return cache.load(key);
    };
    EXPECT_EQ(with_file(whole), binary);
    for (size_t length = 0; length < whole.size(); ++length)
        EXPECT_TRUE(with_file(whole.substr(0, length)).empty()) << length;
    EXPECT_TRUE(with_file(whole + 'x').empty());
    for (size_t at = 0; at < whole.size(); ++at) {
        std::string corrupt = whole;
        corrupt[at] = static_cast<char>(corrupt[at] ^ 0x10);
        EXPECT_TRUE(with_file(corrupt).empty()) << at;
    }
}

TEST(ProgramCache, TakesNoFileOfAnotherKey) {
    const TemporaryFolder folder;
    const ProgramCache cache(folder.path("cache"));
    std::string other = key;
    other.back() = 'x';
    cache.store(other, binary);
    std::filesystem::copy_file(cache.path(other), cache.path(key));
    EXPECT_TRUE(cache.load(key).empty());
    EXPECT_EQ(cache.load(other), binary);
}

TEST(ProgramCache, WithoutAFolderKeepsNothing) {
    const ProgramCache none{""};
    none.store(key, binary);
    EXPECT_TRUE(none.load(key).empty());
    const TemporaryFolder folder;
    const ProgramCache below_a_file(folder.file("file", "x") + "/cache");
    EXPECT_NO_THROW(below_a_file.store(key, binary));
    EXPECT_TRUE(below_a_file.load(key).empty());
}

TEST(ProgramCache, ManyWriters) {
    const TemporaryFolder folder;
    const ProgramCache cache(folder.path("cache"));
    const auto content = [](int writer) {
        return std::vector<unsigned char>(100000 + static_cast<size_t>(writer),
                                          static_cast<unsigned char>(writer));
    };
    // What is read is always one of the files that were written, whole.
    const auto write_and_read = [&](int writer) {
        bool is_whole = true;
        for (int repeat = 0; repeat < 20; ++repeat) {
            cache.store(key, content(writer));
            const std::vector<unsigned char> found = cache.load(key);
            is_whole = is_whole && !found.empty() && found == content(found[0]);
        }
        return is_whole;
    };
    const pid_t child = ::fork();
    if (child == 0) std::_Exit(write_and_read(1) ? 0 : 1);
    ASSERT_GT(child, 0);
    bool results[2] = {};
    std::thread thread([&] { results[0] = write_and_read(2); });
    results[1] = write_and_read(3);
    thread.join();
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    EXPECT_TRUE(results[0]);
    EXPECT_TRUE(results[1]);
    EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path("cache")), {}), 1);
}

class Environment : public testing::Test {
protected:
    void set(const char* name, const char* value) {
        const char* old = std::getenv(name);
        before_.emplace_back(name, old ? old : "");
        had_.push_back(old != nullptr);
        value ? ::setenv(name, value, 1) : ::unsetenv(name);
    }
    ~Environment() override {
        for (size_t i = before_.size(); i-- > 0;)
            had_[i] ? ::setenv(before_[i].first, before_[i].second.c_str(), 1)
                    : ::unsetenv(before_[i].first);
    }

private:
    std::vector<std::pair<const char*, std::string>> before_;
    std::vector<bool> had_;
};

TEST_F(Environment, NamesTheDefaultCacheFolder) {
    set("CLBA_CACHE_DIR", "/a");
    set("XDG_CACHE_HOME", "/b");
    set("HOME", "/c");
    EXPECT_EQ(ProgramCache::default_folder(), "/a");
    set("CLBA_CACHE_DIR", "");
    EXPECT_EQ(ProgramCache::default_folder(), "");
    set("CLBA_CACHE_DIR", nullptr);
    EXPECT_EQ(ProgramCache::default_folder(), "/b/clba");
    set("XDG_CACHE_HOME", nullptr);
    EXPECT_EQ(ProgramCache::default_folder(), "/c/.cache/clba");
    set("HOME", nullptr);
    EXPECT_EQ(ProgramCache::default_folder(), "");
}

size_t num_entries(const std::string& folder) {
    std::error_code error;
    const auto entries = std::filesystem::directory_iterator(folder, error);
    return error ? 0 : static_cast<size_t>(std::distance(entries, {}));
}

TEST(CachedContexts, LoadWhatAnotherCompiled) {
    const TemporaryFolder folder;
    ContextOptions options;
    options.cache_folder = folder.path("cache");
    options.cache_is_required = true;
    // What was compiled is stored when the context ends.
    const auto use = [&] {
        Queue queue(std::make_shared<Context>(options));
        launch_something(queue);
    };
    use();
    ASSERT_EQ(num_entries(options.cache_folder), 1u);
    const auto file = std::filesystem::directory_iterator(options.cache_folder)->path();
    const auto time = std::filesystem::last_write_time(file);
    use();
    EXPECT_EQ(num_entries(options.cache_folder), 1u);
    EXPECT_EQ(std::filesystem::last_write_time(file), time);
    // A file that is not whole is compiled anew and replaced.
    const std::string whole = content_of(file.string());
    std::filesystem::resize_file(file, whole.size() / 2);
    use();
    EXPECT_EQ(std::filesystem::file_size(file), whole.size());
}

TEST(CachedContexts, NeedAFolderThatWasNamedButNoDefault) {
    const TemporaryFolder folder;
    ContextOptions options;
    options.cache_folder = folder.file("file", "x") + "/cache";
    Queue queue(std::make_shared<Context>(options));
    launch_something(queue);
    options.cache_is_required = true;
    EXPECT_TRUE(throws([&] { Context context(options); }, Status::file,
                       {options.cache_folder.c_str(), "CLBA_CACHE_DIR"}));
    options.cache_folder = "";
    EXPECT_NO_THROW(Context context(options));
}

class Buffers : public testing::Test {
protected:
    std::shared_ptr<Context> context = std::make_shared<Context>(ContextOptions());
    Queue queue{context};
};

TEST_F(Buffers, HoldWhatIsWritten) {
    std::vector<double> values(1000), back(1000);
    for (size_t i = 0; i < values.size(); ++i) values[i] = static_cast<double>(i);
    const uint64_t bytes = values.size() * sizeof(double);
    Buffer a(queue, bytes, "a"), b(queue, bytes, "b");
    a.write(values.data(), bytes);
    b.copy_from(a);
    b.read(back.data(), bytes);
    EXPECT_EQ(back, values);
    b.fill_zero();
    b.read(back.data(), bytes);
    EXPECT_EQ(back, std::vector<double>(1000));
    {
        const auto mapping = b.map_write<double>();
        for (int64_t i = 0; i < 1000; ++i) mapping[i] = 2.0 * static_cast<double>(i);
    }
    const auto mapping = b.map_read<double>();
    for (int64_t i = 0; i < 1000; ++i) ASSERT_EQ(mapping[i], 2.0 * static_cast<double>(i));
}

TEST_F(Buffers, MayBeEmpty) {
    Buffer empty(queue, 0, "nothing"), other(queue, 0, "nothing");
    EXPECT_TRUE(empty);
    EXPECT_EQ(empty.bytes(), 0u);
    empty.fill_zero();
    empty.copy_from(other);
    empty.write(nullptr, 0);
    empty.read(nullptr, 0);
    EXPECT_NE(empty.map_read<double>().data(), nullptr);
    EXPECT_FALSE(Buffer());
    EXPECT_EQ(queue.memory().current_bytes, 0u);
}

TEST_F(Buffers, AreAccountedFor) {
    MemoryAccount& memory = queue.memory();
    {
        Buffer a(queue, 1000, "a");
        EXPECT_EQ(memory.current_bytes, 1000u);
        {
            const Buffer b(queue, 500, "b");
            EXPECT_EQ(memory.current_bytes, 1500u);
        }
        EXPECT_EQ(memory.current_bytes, 1000u);
        EXPECT_EQ(memory.peak_bytes, 1500u);
        memory.reset_peak();
        EXPECT_EQ(memory.peak_bytes, 1000u);
        Buffer moved(std::move(a));
        EXPECT_EQ(moved.bytes(), 1000u);
        EXPECT_EQ(memory.current_bytes, 1000u);
        moved = Buffer(queue, 10, "c");
        EXPECT_EQ(memory.current_bytes, 10u);
    }
    EXPECT_EQ(memory.current_bytes, 0u);
}

TEST_F(Buffers, MayNotBeLargerThanTheDeviceAllows) {
    const std::string too_many = std::to_string(context->max_allocation_bytes() + 1);
    EXPECT_TRUE(throws([&] { Buffer buffer(queue, context->max_allocation_bytes() + 1, "a test"); },
                       Status::out_of_memory,
                       {"a test", too_many.c_str(), context->device().name.c_str()}));
    ContextOptions options;
    options.max_allocation_bytes = 1000;
    Queue limited(std::make_shared<Context>(options));
    EXPECT_NO_THROW(Buffer(limited, 1000, "a test"));
    EXPECT_TRUE(throws([&] { Buffer buffer(limited, 1001, "a test"); }, Status::out_of_memory,
                       {"a test wants 1001", "1000"}));
    EXPECT_EQ(limited.memory().current_bytes, 0u);
}

TEST_F(Buffers, EventsOfManyLaunchesAreCollected) {
    for (int i = 0; i < 100; ++i) launch_something(queue);
    const double seconds = queue.step_seconds()[static_cast<size_t>(Step::vector)];
    EXPECT_GT(seconds, 0);
    EXPECT_EQ(queue.step_seconds()[static_cast<size_t>(Step::vector)], seconds);
    Kernel& kernel = queue.kernel("vector.cl", "scale_and_add", "-DREAL=double");
    Buffer x(queue, 64, "x");
    queue.launch(Step::vector, kernel, 0, 8, 1.0, x, 1.0, x);  // no group: nothing happens
    EXPECT_EQ(queue.step_seconds()[static_cast<size_t>(Step::vector)], seconds);
}

}  // namespace
}  // namespace clba::test
