// SPDX-License-Identifier: Apache-2.0
#include <memory>

#include "cli/commands.hpp"
#include "cli/files.hpp"
#include "cli/options.hpp"
#include "cli/outputs.hpp"

namespace cli {
namespace {

struct ConvertArguments {
    std::string input;
    Output output;
};

void convert(const ConvertArguments& arguments) {
    check_outputs({arguments.output.path, {}});
    write_problem(read_problem(arguments.input, false).get(), arguments.output);
}

}  // namespace

void add_convert(CLI::App& program) {
    CLI::App* command =
        program.add_subcommand("convert", "Write a problem in another format; needs no device");
    const auto arguments = std::make_shared<ConvertArguments>();
    command->add_option("IN", arguments->input, problem_help)->required();
    command
        ->add_option(
            "OUT", arguments->output.path,
            "file or folder; its format is that of the ending, COLMAP's for a folder or a name "
            "that ends in /, else that of IN")
        ->check(not_empty)
        ->required();
    add_output_format(*command, "--format", arguments->output);
    command->callback([arguments] { convert(*arguments); });
}

}  // namespace cli
