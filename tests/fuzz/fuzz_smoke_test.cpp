// SPDX-License-Identifier: Apache-2.0
// Every parser on its seeds and on mutations of them that are the same each time: no crash, no
// exception but clba::Error, and no more memory than a small multiple of the input.
#include <gtest/gtest.h>
#include <malloc.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <new>

#include "fuzz/parsers.hpp"

namespace {

std::atomic<int64_t> live_bytes{0}, most_live_bytes{0};

void* counted(size_t size) {
    void* const memory = std::malloc(size > 0 ? size : 1);
    if (!memory) throw std::bad_alloc();
    const int64_t live = live_bytes += static_cast<int64_t>(malloc_usable_size(memory));
    int64_t most = most_live_bytes;
    while (live > most && !most_live_bytes.compare_exchange_weak(most, live)) {
    }
    return memory;
}

void uncount(void* memory) {
    if (!memory) return;
    live_bytes -= static_cast<int64_t>(malloc_usable_size(memory));
    std::free(memory);
}

}  // namespace

void* operator new(size_t size) {
    return counted(size);
}
void* operator new[](size_t size) {
    return counted(size);
}
// libstdc++'s would call the first, AddressSanitizer's does not.
void* operator new(size_t size, const std::nothrow_t&) noexcept {
    try {
        return counted(size);
    } catch (const std::bad_alloc&) {
        return nullptr;
    }
}
void operator delete(void* memory) noexcept {
    uncount(memory);
}
void operator delete[](void* memory) noexcept {
    uncount(memory);
}
void operator delete(void* memory, size_t) noexcept {
    uncount(memory);
}
void operator delete[](void* memory, size_t) noexcept {
    uncount(memory);
}

namespace clba::test {
namespace {

class Random {
public:
    explicit Random(uint64_t seed) : state_(seed * 2 + 1) {}
    size_t below(size_t limit) {  // Knuth's linear congruential generator, its high bits
        state_ = state_ * 6364136223846793005u + 1442695040888963407u;
        return static_cast<size_t>((state_ >> 33) % limit);
    }

private:
    uint64_t state_;
};

std::string mutated(std::string input, Random& random) {
    static const std::string_view words[] = {
        "0",         "-1",  "4294967295", "99999999999999999999",
        "1e308",     "nan", "inf",        "\xff\xff\xff\xff\xff\xff\xff\x7f",
        "[",         "{",   "}",          "\"",
        "\n",        "\t",  " ",          "null",
        "2147483649"};
    const size_t changes = 1 + random.below(3);
    for (size_t c = 0; c < changes && !input.empty(); ++c) {
        const size_t at = random.below(input.size());
        const size_t length = std::min(input.size() - at, 1 + random.below(16));
        switch (random.below(5)) {
            case 0:
                input[at] = static_cast<char>(input[at] ^ (1 << random.below(8)));
                break;
            case 1:
                input.erase(at, length);
                break;
            case 2:
                input.insert(at, input.substr(random.below(input.size()), 1 + random.below(40)));
                break;
            case 3:
                input.replace(at, std::min<size_t>(length, 4),
                              words[random.below(std::size(words))]);
                break;
            default:
                if (random.below(8) == 0) input.resize(at);
        }
    }
    return input;
}

class FuzzSmoke : public testing::TestWithParam<std::string> {};
std::vector<std::string> names() {
    std::vector<std::string> all;
    for (const Parser& parser : parsers()) all.push_back(parser.name);
    return all;
}
INSTANTIATE_TEST_SUITE_P(Parsers, FuzzSmoke, testing::ValuesIn(names()),
                         [](const auto& each) { return each.param; });

TEST_P(FuzzSmoke, SeedsAreAccepted) {
    const Parser& parser = parser_named(GetParam());
    for (const std::string& seed : parser.seeds()) EXPECT_TRUE(accepts(parser, seed)) << seed;
}

TEST_P(FuzzSmoke, MutationsOfThemAreReadOrRefused) {
    const Parser& parser = parser_named(GetParam());
    constexpr int64_t fixed_bytes = int64_t{12} << 20;  // blocks of readers and writers
    Random random(1);
    int num_accepted = 0, num_refused = 0;
    for (const std::string& seed : parser.seeds())
        for (int i = 0; i < 300; ++i) {
            const std::string input = mutated(seed, random);
            const int64_t before = live_bytes;
            most_live_bytes = before;
            (accepts(parser, input) ? num_accepted : num_refused) += 1;
            ASSERT_LE(most_live_bytes - before,
                      fixed_bytes + 200 * static_cast<int64_t>(input.size()))
                << input;
        }
    EXPECT_GT(num_accepted, 0);
    EXPECT_GT(num_refused, 0);
}

}  // namespace
}  // namespace clba::test
