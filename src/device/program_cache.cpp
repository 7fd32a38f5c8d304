// SPDX-License-Identifier: Apache-2.0
#include "device/program_cache.hpp"

#include <zlib.h>

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "base/atomic_file.hpp"
#include "base/error.hpp"

namespace clba {
namespace {

constexpr char magic[8] = {'c', 'l', 'b', 'a', 'p', 'r', 'g', '1'};

// File: this header, the key, the binary.
struct Header {
    char magic[8];
    uint64_t key_bytes;
    uint64_t binary_bytes;
    uint64_t checksum;  // CRC-32 of key and binary
};

uint64_t checksum(const std::string& key, const unsigned char* binary, size_t bytes) {
    uLong crc = ::crc32_z(0, reinterpret_cast<const Bytef*>(key.data()), key.size());
    return ::crc32_z(crc, binary, bytes);
}

// FNV-1a. The key itself is in the file, so a collision costs a recompilation and nothing else.
uint64_t hash(const std::string& value) {
    uint64_t h = 0xcbf29ce484222325u;
    for (unsigned char c : value) h = (h ^ c) * 0x100000001b3u;
    return h;
}

}  // namespace

std::string ProgramCache::path(const std::string& key) const {
    char name[32];
    std::snprintf(name, sizeof name, "%016llx.clbin", static_cast<unsigned long long>(hash(key)));
    return folder_ + "/" + name;
}

std::vector<unsigned char> ProgramCache::load(const std::string& key) const {
    if (folder_.empty()) return {};
    std::ifstream file(path(key), std::ios::binary);
    const std::vector<char> bytes{std::istreambuf_iterator<char>(file),
                                  std::istreambuf_iterator<char>()};
    Header header;
    if (bytes.size() < sizeof header) return {};
    std::memcpy(&header, bytes.data(), sizeof header);
    if (std::memcmp(header.magic, magic, sizeof magic) != 0 || header.key_bytes != key.size() ||
        header.binary_bytes != bytes.size() - sizeof header - key.size())
        return {};
    const char* stored_key = bytes.data() + sizeof header;
    const auto* binary = reinterpret_cast<const unsigned char*>(stored_key + key.size());
    if (std::memcmp(stored_key, key.data(), key.size()) != 0 ||
        checksum(key, binary, header.binary_bytes) != header.checksum)
        return {};
    return {binary, binary + header.binary_bytes};
}

void ProgramCache::store(const std::string& key, const std::vector<unsigned char>& binary) const {
    if (folder_.empty()) return;
    std::error_code error;
    std::filesystem::create_directories(folder_, error);
    Header header;
    std::memcpy(header.magic, magic, sizeof magic);
    header.key_bytes = key.size();
    header.binary_bytes = binary.size();
    header.checksum = checksum(key, binary.data(), binary.size());
    try {
        AtomicFile file(path(key));
        file.write({reinterpret_cast<const char*>(&header), sizeof header});
        file.write(key);
        file.write({reinterpret_cast<const char*>(binary.data()), binary.size()});
        file.commit();
    } catch (const Error&) {
        // A cache that cannot be written costs time at the next start and nothing else.
    }
}

std::string ProgramCache::default_folder() {
    if (const char* folder = std::getenv("CLBA_CACHE_DIR")) return folder;
    if (const char* base = std::getenv("XDG_CACHE_HOME"); base && *base)
        return std::string(base) + "/clba";
    if (const char* home = std::getenv("HOME"); home && *home)
        return std::string(home) + "/.cache/clba";
    return "";
}

}  // namespace clba
