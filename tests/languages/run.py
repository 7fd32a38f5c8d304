# SPDX-License-Identifier: Apache-2.0
"""Builds and runs the examples in other languages against an installed copy of the library.

run.py install WORK CMAKE BUILD    installs the build to WORK/prefix and makes a scene
run.py LANGUAGE WORK SOURCE        builds and runs examples/LANGUAGE and, where tests/languages has one,
                                   its probe: struct layouts, an error, a callback that raises

Languages other than C must end at C's costs, digit by digit. Without the toolchain the exit code is
77, with the reason on the last line."""
import os
import pathlib
import re
import shutil
import subprocess
import sys

SKIPPED = 77
SCENE = "scene.txt.bz2"
STOP_AFTER = 3


class Failure(Exception):
    pass


def require(holds, message):
    if not holds:
        raise Failure(message)


def tool(name):
    path = shutil.which(name)
    if not path:
        print(f"skipped: no {name} on PATH; scripts/install-test-packages installs it")
        sys.exit(SKIPPED)
    return path


def run(*command, hint=None, **options):
    """Standard output of a command that must succeed."""
    print("$", *command, flush=True)
    done = subprocess.run([str(part) for part in command], text=True, stdout=subprocess.PIPE,
                          **options)
    print(done.stdout, flush=True)
    if done.returncode:
        raise Failure(f"{command[0]} ended with {done.returncode}" + (f": {hint}" if hint else ""))
    return done.stdout


def install(work, cmake, build):
    shutil.rmtree(work / "prefix", ignore_errors=True)
    work.mkdir(parents=True, exist_ok=True)
    run(cmake, "--install", build, "--prefix", work / "prefix")
    run(work / "prefix/bin/clba", "generate", "hall", "--images", 24, "--observations-per-image",
        120, "--seed", 3, "-o", work / SCENE)


def pkg_config(what):
    return run(tool("pkg-config"), what, "clba").split()


# Each builds in an empty folder, where it may leave what saves time the next time in ../cache, and
# returns the commands that run the example and the probe.


def build_c(source, cache):
    run(tool("cc"), "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror",
        source / "examples/c/solve.c", *pkg_config("--cflags"), *pkg_config("--libs"), "-o",
        "solve")
    return ["./solve"], None


def build_cpp(source, cache):
    run(tool("c++"), "-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror",
        source / "examples/cpp/solve.cpp", *pkg_config("--cflags"), *pkg_config("--libs"), "-o",
        "solve")
    return ["./solve"], None


def build_rust(source, cache):
    rustc = [tool("rustc"), "--edition", "2021", "-D", "warnings", "-L",
             "native=" + pkg_config("--variable=libdir")[0]]
    run(*rustc, "--crate-type", "rlib", source / "examples/rust/clba.rs")
    for program in ("examples/rust/solve.rs", "tests/languages/probe.rs"):
        run(*rustc, "--extern", "clba=libclba.rlib", source / program)
    return ["./solve"], ["./probe"]


def build_go(source, cache):
    go = tool("go")
    shutil.copytree(source / "examples/go", ".", dirs_exist_ok=True)
    shutil.copy(source / "tests/languages/probe.go", "probe.go")
    os.environ.update(GOCACHE=str(cache / "build"), GOPATH=str(cache / "path"), GOPROXY="off",
                      GOTOOLCHAIN="local", GOFLAGS="-buildvcs=false", CGO_ENABLED="1")
    for program in ("solve", "probe"):
        run(go, "vet", f"{program}.go")
        run(go, "build", "-o", program, f"{program}.go")
    return ["./solve"], ["./probe"]


def build_java(source, cache):
    java, javac = tool("java"), tool("javac")
    run(tool("cmake"), "-P", source / "examples/java/fetch-jna.cmake", cwd=cache,
        hint="is Maven Central reachable?")
    path = [f"{cache}/jna.jar", "classes"]
    run(javac, "-Xlint:all", "-Werror", "-cp", path[0], "-d", path[1],
        *source.glob("examples/java/*.java"), source / "tests/languages/Probe.java")
    start = [java, "-cp", ":".join(path)]
    return [*start, "Solve"], [*start, "Probe"]


def build_javascript(source, cache):
    node, npm = tool("node"), tool("npm")
    for file in source.glob("examples/javascript/*.js*"):
        shutil.copy(file, ".")
    shutil.copy(source / "tests/languages/probe.js", ".")
    # koffi's binary is a package of its own; the script would build it where there is none.
    run(npm, "ci", "--ignore-scripts", "--prefer-offline", "--no-audit", "--no-fund",
        "--cache", cache, hint="is the npm registry reachable?")
    return [node, "solve.js"], [node, "probe.js"]


BUILDERS = {name.removeprefix("build_"): builder for name, builder in list(globals().items())
            if name.startswith("build_")}


def check_solve(output):
    """What the example did, as far as it must be equal for all languages."""
    number = r"([\d.]+e[+-]?\d+)"
    rows = [(int(index), float(cost)) for index, cost
            in re.findall(rf"^ *(\d+)  cost {number}$", output, re.M)]
    first, second = rows[:STOP_AFTER + 1], rows[STOP_AFTER + 1:]
    require([index for index, _ in first] == list(range(STOP_AFTER + 1)) and len(second) > 1 and
            [index for index, _ in second] == list(range(len(second))),
            f"the callback was called with the wrong iterations: {rows}")
    stopped, final = (re.search(rf"^{what} {number}$", output, re.M) for what
                      in ("stopped at", "final cost"))
    require(stopped and final, "no costs in the output")
    digits = [len(re.sub(r"e.*|\D", "", match[1])) for match in (stopped, final)]
    require(digits == [17, 17], f"costs have {digits} digits, but 17 are needed")
    costs = float(stopped[1]), float(final[1])
    require(costs[0] > costs[1], "the second solve found nothing better")
    reported = re.search(rf"^  final +{number}$", output, re.M)
    require(reported and abs(float(reported[1]) / costs[1] - 1) < 1e-9,
            "the report has another final cost")
    require(re.search(r"^Termination +convergence", output, re.M), "the solve did not converge")
    return {"rows": rows, "stopped": costs[0], "final": costs[1]}


def layout_in_c(source):
    """Offset and size of every field of every public struct: a compiled program's word."""
    header = re.sub(r"/\*.*?\*/", "",
                    (source / "include/clba/clba.h").read_text(encoding="utf-8"), flags=re.S)
    lines = []
    for name, body in re.findall(r"typedef struct (\w+) \{(.*?)\} \1;", header, re.S):
        lines.append(f'printf("size {name} %zu\\n", sizeof({name}));')
        for field in re.findall(r"(\w+)(?:\[\d+\])?\s*[,;]", body):
            lines.append(f'printf("layout {name}.{field} %zu %zu\\n", offsetof({name}, {field}), '
                         f"sizeof((({name}*)0)->{field}));")
    require(lines, "no structs in clba.h")
    pathlib.Path("layout.c").write_text(
        "#include <clba/clba.h>\n#include <stdio.h>\nint main(void) {\n" + "\n".join(lines) +
        "\nreturn 0;\n}\n", encoding="utf-8")
    run(tool("cc"), "layout.c", *pkg_config("--cflags"), "-o", "layout")
    return set(run("./layout").splitlines())


def check_probe(output, source, absent):
    lines = set(output.splitlines())
    layout = {line for line in lines if re.match("size|layout", line)}
    structs = {line.split()[1] for line in layout if line.startswith("size")}
    if layout:
        require({"clba_iteration", "clba_solver_options", "clba_summary"} <= structs,
                f"layouts of {structs} alone")
        expected = {line for line in layout_in_c(source)
                    if line.split()[1].split(".")[0] in structs}
        require(layout == expected, "not as in clba.h: " + ", ".join(sorted(layout ^ expected)))
    require("raised at iteration 1: calls 2" in lines, "a callback's error did not come through")
    require(any(line.startswith("status -7: ") and str(absent) in line for line in lines),
            "an error without its status or message")


def language(name, work, source):
    folder, cache = work / name, work / f"cache-{name}"
    shutil.rmtree(folder, ignore_errors=True)
    for made in (folder, cache):
        made.mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    libdir = next(work.glob("prefix/lib*/**/pkgconfig"))
    os.environ.update(PKG_CONFIG_PATH=str(libdir), LD_LIBRARY_PATH=str(libdir.parent))
    example, probe = BUILDERS[name](source, cache)
    done = check_solve(run(*example, work / SCENE))
    reference = work / "c-costs.txt"
    if name == "c":
        reference.write_text(repr(done), encoding="utf-8")
    expected = reference.read_text(encoding="utf-8")
    require(repr(done) == expected, f"{done}, but C found {expected}")
    if probe:
        absent = work / "absent.txt"
        check_probe(run(*probe, work / SCENE, absent), source, absent)


def main():
    what, work, *rest = sys.argv[1:]
    work = pathlib.Path(work).resolve()
    try:
        if what == "install":
            install(work, *rest)
        else:
            language(what, work, pathlib.Path(rest[0]).resolve())
    except Failure as failure:
        sys.exit(f"{what}: {failure}")


main()
