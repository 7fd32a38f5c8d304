// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <string>
#include <vector>

#include "clba/clba.h"

namespace clba {

// The whole summary as a text of several lines.
std::string report_text(const clba_summary& summary, const std::vector<clba_iteration>& rows);

// The same as JSON: the fields of clba_summary under their names, enumerations as their names,
// numbers that are not finite as null, and the rows as "iterations".
std::string report_json(const clba_summary& summary, const std::vector<clba_iteration>& rows);

}  // namespace clba
