// SPDX-License-Identifier: Apache-2.0
#include "device/kernel_source.hpp"

#include <set>
#include <string_view>

#include "base/error.hpp"

namespace clba {
namespace {

const char* find_source(const std::string& path) {
    for (int i = 0; i < num_embedded_kernels; ++i)
        if (path == embedded_kernels[i].path) return embedded_kernels[i].source;
    fail(Status::internal, "no embedded kernel file ", path);
}

void append_source(const std::string& path, const std::string& camera_model_path,
                   std::set<std::string>& included, std::string& out) {
    if (!included.insert(path).second) return;
    std::string_view rest = find_source(path);
    out += text("#line 1 \"kernels/", path, "\"\n");
    for (int line_number = 1; !rest.empty(); ++line_number) {
        const size_t end = rest.find('\n');
        const std::string_view line = rest.substr(0, end);
        rest = end == std::string_view::npos ? std::string_view() : rest.substr(end + 1);
        constexpr std::string_view directive = "#include \"";
        if (line.substr(0, directive.size()) != directive) {
            out.append(line);
            out += '\n';
            continue;
        }
        const std::string_view name = line.substr(directive.size());
        std::string target(name.substr(0, name.find('"')));
        if (target == "camera_model.clh" && !camera_model_path.empty()) target = camera_model_path;
        append_source(target, camera_model_path, included, out);
        out += text("#line ", line_number + 1, " \"kernels/", path, "\"\n");
    }
}

}  // namespace

std::string kernel_source(const std::string& path, const std::string& camera_model_path) {
    std::set<std::string> included;
    std::string out;
    append_source(path, camera_model_path, included, out);
    return out;
}

}  // namespace clba
