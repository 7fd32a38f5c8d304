// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "base/error.hpp"

namespace clba::test {

// A folder of the test's own, removed with all it holds.
class TemporaryFolder {
public:
    TemporaryFolder() {
        static int counter = 0;
        folder_ = std::filesystem::path(testing::TempDir()) /
                  text("clba_test_", ::getpid(), "_", counter++);
        std::filesystem::create_directory(folder_);
    }
    ~TemporaryFolder() { std::filesystem::remove_all(folder_); }
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;

    std::string path(const std::string& name) const { return (folder_ / name).string(); }
    std::string file(const std::string& name, const std::string& content) const {
        std::ofstream(path(name), std::ios::binary) << content;
        return path(name);
    }
    size_t num_files() const {
        return static_cast<size_t>(std::distance(std::filesystem::directory_iterator(folder_), {}));
    }

private:
    std::filesystem::path folder_;
};

inline std::string content_of(const std::string& path) {
    std::ifstream stream(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
}

// Whether the call throws an error of this status whose message holds all parts.
template <class Call>
testing::AssertionResult throws(const Call& call, Status status,
                                std::initializer_list<std::string> parts) {
    try {
        call();
    } catch (const Error& error) {
        const std::string message = error.what();
        if (error.status() != status)
            return testing::AssertionFailure()
                   << "status " << static_cast<int>(error.status()) << ": " << message;
        for (const std::string& part : parts)
            if (message.find(part) == std::string::npos)
                return testing::AssertionFailure() << "no \"" << part << "\" in: " << message;
        return testing::AssertionSuccess();
    }
    return testing::AssertionFailure() << "nothing was thrown";
}

}  // namespace clba::test
