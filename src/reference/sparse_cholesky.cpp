// SPDX-License-Identifier: Apache-2.0
#include "reference/sparse_cholesky.hpp"

#include <cstdlib>
#include <string>
#include <utility>

#include "base/dynamic_library.hpp"
#include "base/error.hpp"

namespace clba::reference {
namespace {

std::vector<std::string> plugin_names() {
    const char* path = std::getenv("CLBA_CHOLMOD");
    if (path && *path) return {path};
    const std::string name = text("libclba_cholmod.so.", CLBA_SOVERSION);
    const std::string folder = own_folder();
    if (folder.empty()) return {name};
    return {folder + name, name};
}

template <class Function>
void find(const DynamicLibrary& library, const char* name, Function*& function) {
    function = library.symbol<Function>(name);
    if (!function)
        fail(Status::no_plugin, "the library opened as clba_cholmod has no function ", name,
             "; CLBA_CHOLMOD must name the plug-in of this clba, or be unset");
}

const CholmodPlugin& plugin() {
    static const CholmodPlugin opened = open_cholmod_plugin();
    return opened;
}

}  // namespace

CholmodPlugin open_cholmod_plugin(int32_t version) {
    const DynamicLibrary library(plugin_names());
    if (!library.is_open())
        fail(Status::no_plugin, "direct_schur needs the plug-in library clba_cholmod (",
             library.error(),
             "); build clba with -DCLBA_BUILD_CHOLMOD=ON, install the library beside clba, or set "
             "the environment variable CLBA_CHOLMOD to its path");

    decltype(clba_cholmod_version)* found_version = nullptr;
    find(library, "clba_cholmod_version", found_version);
    if (found_version() != version)
        fail(Status::no_plugin, "the plug-in library clba_cholmod has interface version ",
             found_version(), ", but this clba needs ", version,
             "; install the plug-in built with this clba, or set CLBA_CHOLMOD to its path");

    CholmodPlugin found;
    find(library, "clba_cholmod_create", found.create);
    find(library, "clba_cholmod_destroy", found.destroy);
    find(library, "clba_cholmod_analyze", found.analyze);
    find(library, "clba_cholmod_factorize", found.factorize);
    find(library, "clba_cholmod_solve", found.solve);
    find(library, "clba_cholmod_factor_nonzeros", found.factor_nonzeros);
    find(library, "clba_cholmod_message", found.message);
    return found;
}

SparseCholesky::SparseCholesky(std::vector<int64_t> column_starts, std::vector<int64_t> rows)
    : column_starts_(std::move(column_starts)),
      rows_(std::move(rows)),
      handle_(nullptr, plugin().destroy) {
    const auto n = static_cast<int64_t>(column_starts_.size()) - 1;
    handle_.reset(plugin().create(n, column_starts_.data(), rows_.data()));
    if (!handle_) fail(Status::out_of_memory, "no memory for a sparse Cholesky factorisation");
    check(plugin().analyze(handle_.get()));
}

// CHOLMOD takes the null pointers of an empty matrix for errors.
bool SparseCholesky::factorize(const double* values) {
    if (rows_.empty()) return true;
    const int32_t status = plugin().factorize(handle_.get(), values);
    check(status);
    return status == CLBA_CHOLMOD_OK;
}

void SparseCholesky::solve(const double* b, double* x) {
    if (rows_.empty()) return;
    check(plugin().solve(handle_.get(), b, x));
}

int64_t SparseCholesky::num_factor_nonzeros() const {
    return plugin().factor_nonzeros(handle_.get());
}

void SparseCholesky::check(int32_t status) const {
    if (status >= 0) return;
    const auto kind =
        status == CLBA_CHOLMOD_OUT_OF_MEMORY ? Status::out_of_memory : Status::internal;
    fail(kind, "sparse Cholesky factorisation of ", column_starts_.size() - 1, " unknowns and ",
         rows_.size(), " entries: ", plugin().message(handle_.get()));
}

}  // namespace clba::reference
