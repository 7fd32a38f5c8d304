// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "io/text_output.hpp"

namespace clba {

// A row of tracks.csv: a feature of an image and the track it belongs to.
struct OpenSfmTrackRow {
    int32_t image = 0, track = 0;  // in the lists of names
    int32_t feature = 0;
    double x = 0, y = 0, scale = 0;
    std::array<int32_t, 3> color{};
    int32_t segmentation = -1, instance = -1;
};

struct OpenSfmTracks {
    int version = 2;  // 0: 8 columns; 1: and a scale; 2: and segmentation, instance
    bool has_header = true;
    std::vector<std::string> images, tracks;  // names, each once
    std::vector<OpenSfmTrackRow> rows;
};

OpenSfmTracks read_opensfm_tracks(const std::string& path);
void put_opensfm_tracks(TextOutput& output, const OpenSfmTracks& tracks);

}  // namespace clba
