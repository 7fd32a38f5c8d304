# SPDX-License-Identifier: Apache-2.0
"""The clba command: what it prints and writes, its exit codes, and that bad input leaves nothing."""
import gzip
import json
import math
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import unittest

CLBA = pathlib.Path(sys.argv[1]).resolve()
DATA = pathlib.Path(os.environ.get("CLBA_TEST_DATA", ""))
USAGE, FILE, NO_DEVICE, INTERRUPTED = 2, 4, 5, 130
# Tolerances that let two solvers meet in all digits that are compared.
CONVERGED = ["--function-tolerance", "1e-14", "--max-iterations", "200"]

# Two images, one point, two observations.
SMALL = """2 1 2
0 0 1.0 2.0
1 0 -1.0 2.0
0 0 0 0 0 -5 500 0 0
0 0.1 0 0 0 -5 500 0 0
0.1 0.2 0.3
"""


class CliTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def clba(self, *arguments, exit_code=0, **environment):
        done = subprocess.run([CLBA, *map(str, arguments)], cwd=self.folder, text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                              env={**os.environ, **environment})
        self.assertEqual(done.returncode, exit_code, done.stdout + done.stderr)
        return done

    def refused(self, exit_code, *arguments, mentions=""):
        """An error is one line that names what is wrong, and no file appears."""
        before = sorted(self.folder.iterdir())
        error = self.clba(*arguments, exit_code=exit_code).stderr
        self.assertRegex(error, r"\Aclba: error: [^\n]+\n\Z")
        self.assertIn(mentions, error)
        self.assertEqual(sorted(self.folder.iterdir()), before)

    def write(self, text, name="problem.txt"):
        (self.folder / name).write_text(text, encoding="utf-8")
        return name

    def scene(self, *options, kind="hall", images=12, per_image=80, seed=7, name="scene.txt"):
        self.clba("generate", kind, "-o", name, "--images", images,
                  "--observations-per-image", per_image, "--seed", seed, *options)
        return name

    def summary(self, name="summary.json"):
        return json.loads((self.folder / name).read_text(encoding="utf-8"))

    def solve(self, file, *options):
        self.clba("solve", file, "--json", "summary.json", "--quiet", *options)
        return self.summary()


class Usage(CliTest):
    def test_help_documents_exit_codes(self):
        self.assertIn("Exit codes", self.clba("--help").stdout)
        self.assertIn("Exit codes", self.clba("solve", "--help").stdout)

    def test_version(self):
        self.assertRegex(self.clba("--version").stdout, r"^clba \d+\.\d+\.\d+\n$")

    def test_bad_arguments(self):
        for arguments in ([], ["paint"], ["solve"], ["solve", "--colour", "x"],
                          ["generate", "castle", "-o", "x"], ["generate", "hall"],
                          ["solve", "x", "--linear-solver", "magic"],
                          ["solve", "x", "--max-iterations", "-1"],
                          ["solve", "x", "--max-iterations", "many"],
                          ["solve", "x", "--loss-scale", "0"],
                          ["solve", "x", "--loss-scale", "inf"],
                          ["solve", "x", "--time-limit", "nan"],
                          ["solve", "x", "--target-cost", "-1"]):
            with self.subTest(arguments):
                self.clba(*arguments, exit_code=USAGE)

    def test_values_that_the_library_refuses(self):
        file = self.scene()
        self.refused(USAGE, "solve", file, "--eta", "1.5", "-o", "out.txt")
        self.refused(USAGE, "generate", "hall", "--images", "1", "-o", "out.txt")
        self.refused(USAGE, "generate", "hall", "--noise", "nan", "-o", "out.txt")

    def test_options_that_would_have_no_effect(self):
        file = self.scene()
        for options in (["--loss-scale", "2"], ["--gauge-images", "0", "1"],
                        ["--covariance-gauge", "inner"], ["--covariance-points"],
                        ["--align-to-priors"]):
            with self.subTest(options):
                self.clba("solve", file, *options, exit_code=USAGE)

    def test_inputs_are_not_lost(self):
        file = self.scene()
        gps = self.write("0,0,0,0,1,1,1\n", "gps.csv")
        (self.folder / "link.txt").symlink_to("scene.txt")
        before = (self.folder / file).read_bytes()
        for option in ("--ply", "--json", "--covariance", "--checkpoint"):
            for name in (file, "./" + file, "link.txt"):
                with self.subTest(option, name=name):
                    self.refused(USAGE, "solve", file, option, name, mentions="an input")
            self.refused(USAGE, "solve", file, "--position-priors", gps, option, gps,
                         mentions="an input")
        self.refused(USAGE, "solve", file, "--position-priors", gps, "-o", gps,
                     mentions="an input")
        self.refused(USAGE, "filter", file, "out.txt", "--json", file, mentions="an input")
        self.assertEqual((self.folder / file).read_bytes(), before)
        self.solve(file, "--checkpoint", "c", "--max-iterations", 1)
        self.refused(USAGE, "solve", file, "--resume", "c", "--json", "c", mentions="an input")
        self.solve(file, "--checkpoint", "c", "--resume", "c")

    def test_two_outputs_of_one_name(self):
        file = self.scene()
        self.refused(USAGE, "solve", file, "-o", "x", "--ply", "./x", mentions="x")


class Filter(CliTest):
    def test_outliers_go(self):
        truth = "truth.txt"
        self.scene("--outliers", "0.1", "--truth", truth)
        done = self.clba("filter", truth, "kept.txt", "--max-error", "4", "--min-angle", "1.5",
                         "--json", "counts.json")
        counts = self.summary("counts.json")
        self.assertGreater(counts["num_large_error"], 30)
        self.assertRegex(done.stdout, rf"Observations removed +{counts['num_observations_removed']}")
        before, kept = ((self.folder / name).read_text().split()[2] for name in (truth, "kept.txt"))
        self.assertEqual(int(before) - int(kept), counts["num_observations_removed"])
        self.clba("filter", "kept.txt", "kept.txt", "--json", "counts.json", "--quiet")
        self.assertEqual(self.summary("counts.json")["num_observations_removed"], 0)

    def test_rules_and_points_can_be_kept(self):
        file = self.scene("--outliers", "0.1")
        self.clba("filter", file, "out.txt", "--max-error", "1e9", "--min-angle", "0",
                  "--min-views", "0", "--keep-behind", "--keep-points", "--json", "counts.json")
        self.assertEqual(set(self.summary("counts.json").values()), {0})
        sizes = [(self.folder / name).read_text().split()[:3] for name in (file, "out.txt")]
        self.assertEqual(*sizes)

    def test_bad_arguments(self):
        file = self.scene()
        self.refused(USAGE, "filter", file, "out.txt", "--min-angle", "180", mentions="180")
        self.refused(FILE, "filter", "absent.txt", "out.txt", mentions="absent.txt")
        for arguments in ([file], [file, "out.txt", "--max-error", "0"]):
            self.clba("filter", *arguments, exit_code=USAGE)

    def test_solve_filter_solve(self):
        file = self.scene("--outliers", "0.05")
        summary = self.solve(file, "--loss", "cauchy", "--filter-rounds", "2", "-o", "out.txt")
        self.assertIn(len(summary["filter"]), (1, 2))
        removed = sum(counts["num_observations_removed"] for counts in summary["filter"])
        self.assertGreater(removed, 20)
        given = int((self.folder / file).read_text().split()[2])
        self.assertEqual(summary["observations"], given - removed)
        self.assertLess(summary["median_residual"], 1)
        self.clba("solve", file, "--filter-rounds", "1", "--verify", exit_code=USAGE)
        self.refused(USAGE, "solve", file, "--filter-rounds", "1", "--filter-max-error", "1e-9",
                     "--quiet", "-o", "none.txt", mentions="all observations")


class Checkpoints(CliTest):
    def test_goes_on_to_the_same_file(self):
        file = self.scene("--outliers", "0.02")
        options = ["--loss", "huber", "--function-tolerance", "1e-9"]
        whole = self.solve(file, *options, "-o", "whole.txt")
        self.solve(file, *options, "-o", "part.txt", "--max-iterations", "2", "--checkpoint", "c")
        resumed = self.solve(file, *options, "-o", "resumed.txt", "--resume", "c")
        self.assertEqual(resumed["resumed_iteration"], 2)
        self.assertEqual(len(resumed["iterations"]), len(whole["iterations"]))
        texts = [(self.folder / name).read_text() for name in ("whole.txt", "resumed.txt")]
        self.assertEqual(*texts)
        self.refused(FILE, "solve", file, *options, "--resume", "whole.txt", "--quiet", "-o", "x",
                     mentions="no checkpoint")
        self.refused(USAGE, "solve", file, "--resume", "c", "--quiet", "-o", "x",
                     mentions="another problem")
        self.refused(FILE, "solve", file, "--checkpoint", "absent/c", mentions="absent")
        self.clba("solve", file, "--checkpoint", "c", "--filter-rounds", "1", exit_code=USAGE)


class Devices(CliTest):
    def test_list(self):
        self.assertRegex(self.clba("devices").stdout, r"(?m)^0: .+\n   platform")

    def test_no_such_device(self):
        file = self.scene()
        for device in ("no such device", "999"):
            self.refused(NO_DEVICE, "solve", file, "--device", device, "-o", "out.txt",
                         mentions=device)

    def test_device_from_the_environment(self):
        file = self.scene()
        self.clba("solve", file, "--quiet", CLBA_DEVICE="0")
        error = self.clba("solve", file, "-o", "out.txt", exit_code=NO_DEVICE,
                          CLBA_DEVICE="no such device").stderr
        self.assertIn("no such device", error)
        self.assertFalse((self.folder / "out.txt").exists())
        # An option wins over the environment.
        self.clba("solve", file, "--quiet", "--device", "0", CLBA_DEVICE="no such device")

    def test_no_driver(self):
        self.clba("devices", exit_code=NO_DEVICE, OCL_ICD_VENDORS=str(self.folder))


class Info(CliTest):
    def test_counts(self):
        text = self.clba("info", self.write(SMALL)).stdout
        self.assertRegex(text, r"(?m)^images +2$")
        self.assertRegex(text, r"(?m)^points +1$")
        self.assertRegex(text, r"(?m)^observations +2$")
        self.assertRegex(text, r"(?m)^observations per point +min 2, median 2, mean 2.00, max 2;")

    def test_bad_files(self):
        lines = SMALL.splitlines(keepends=True)
        bad = {
            "empty": "",
            "garbage": "\x01\x02 not a problem",
            "cut off": "".join(lines[:-1]),
            "cut in a line": SMALL[:60],
            "negative count": SMALL.replace("2 1 2", "-2 1 2", 1),
            "counts that overflow": SMALL.replace("2 1 2", "2 1 99999999999999999999", 1),
            "counts beyond the file": SMALL.replace("2 1 2", "2147483647 2147483647 9e18", 1),
            "image out of range": SMALL.replace("1 0 -1.0", "2 0 -1.0", 1),
            "point out of range": SMALL.replace("1 0 -1.0", "1 1 -1.0", 1),
            "negative index": SMALL.replace("1 0 -1.0", "-1 0 -1.0", 1),
            "not a number": SMALL.replace("-1.0 2.0", "nan 2.0", 1),
            "infinite": SMALL.replace("-1.0 2.0", "inf 2.0", 1),
            "word": SMALL.replace("-1.0 2.0", "one 2.0", 1),
        }
        for what, text in bad.items():
            with self.subTest(what):
                file = self.write(text)
                self.refused(FILE, "info", file, mentions=file)
                self.refused(FILE, "solve", file, "-o", "out.txt", "--json", "out.json",
                             mentions=file)

    def test_no_such_file(self):
        self.refused(FILE, "info", "absent.txt", mentions="absent.txt")
        self.refused(FILE, "solve", "absent.txt", "-o", "out.txt", mentions="absent.txt")

    def test_folder(self):
        (self.folder / "sub").mkdir()
        self.refused(FILE, "info", "sub", mentions="sub")


class Convert(CliTest):
    MODEL = {
        "cameras.txt": "5 SIMPLE_RADIAL 640 480 500 320 240 0.1\n",
        "images.txt": "9 1 0 0 0 0 0 5 5 a.jpg\n330 250 70 1 2 -1\n"
                      "4 1 0 0 0 1 0 5 5 b.jpg\n430 250 70\n",
        "points3D.txt": "70 0.1 0.1 0 255 0 1 0 9 0 4 0\n",
    }

    def model(self):
        (self.folder / "model").mkdir()
        for name, text in self.MODEL.items():
            self.write(text, "model/" + name)
        return "model"

    def files(self, name):
        return {path.name: path.read_bytes() for path in (self.folder / name).iterdir()}

    def test_info_tells_the_format(self):
        text = self.clba("info", self.model()).stdout
        self.assertRegex(text, r"(?m)^format +colmap_text$")
        self.assertRegex(text, r"(?m)^cameras +1, of which 1 shared$")
        self.assertRegex(self.clba("info", self.write(SMALL)).stdout, r"(?m)^format +bal$")

    def test_formats_by_name_and_by_option(self):
        model = self.model()
        self.clba("convert", model, "binary/", "--format", "colmap_binary")
        self.assertEqual(set(self.files("binary")), {"cameras.bin", "images.bin", "points3D.bin"})
        self.clba("convert", "binary", "text", "--format", "colmap_text")
        self.clba("convert", "text", "again/")
        self.assertEqual(self.files("again"), self.files("text"))
        self.clba("convert", model, "model.ply")
        self.assertTrue((self.folder / "model.ply").read_bytes().startswith(b"ply\n"))
        self.clba("convert", self.write(SMALL), "from bal/")
        self.assertIn("cameras.bin", self.files("from bal"))

    def test_what_would_be_lost_is_listed_and_can_be_accepted(self):
        model = self.model()
        self.refused(USAGE, "convert", model, "out.txt", mentions="names and ids of images")
        self.refused(USAGE, "solve", model, "-o", "out.txt.gz", mentions="principal points")
        self.clba("convert", model, "out.txt", "--accept-loss")
        lines = (self.folder / "out.txt").read_text(encoding="utf-8").splitlines()
        self.assertEqual(lines[:3], ["2 1 2", "0 0 10 -10", "1 0 110 -10"])
        self.assertEqual(self.clba("info", "out.txt").stdout.count("bal"), 1)

    def test_solve_writes_the_format_of_its_input(self):
        model = self.model()
        before = self.files(model)
        self.clba("solve", model, "-o", "solved", "--max-iterations", 2, "--quiet")
        self.assertEqual(set(self.files("solved")), set(before))
        self.assertIn(b" a.jpg\n330 250 70 1 2 -1 \n", self.files("solved")["images.txt"])
        self.clba("solve", model, "-o", "binary", "--output-format", "colmap_binary",
                  "--max-iterations", 2, "--quiet")
        self.assertIn("points3D.bin", self.files("binary"))
        self.clba("solve", model, "-o", model, "--max-iterations", 2, "--quiet")
        self.assertEqual(self.files(model), self.files("solved"))

    def test_rigs_are_solved_and_come_back(self):
        model = self.model()
        camera = self.MODEL["cameras.txt"]
        self.write(camera + camera.replace("5", "3", 1), "model/cameras.txt")
        images = self.MODEL["images.txt"].replace("5 b.jpg", "3 b.jpg")
        self.write(images, "model/images.txt")
        self.write("8 2 CAMERA 5 CAMERA 3 1 1 0 0 0 0.875 0 0\n", "model/rigs.txt")
        self.write("30 8 1 0 0 0 0 0 5 2 CAMERA 5 9 CAMERA 3 4\n", "model/frames.txt")
        self.assertRegex(self.clba("info", model).stdout, r"(?m)^rigs +1 frames of 2 sensors$")
        solve = ["solve", model, "--max-iterations", 3, "--quiet", "-o"]
        self.clba(*solve, "refined")
        self.clba(*solve, "held", "--constant-sensors")

        def rows(folder, name):
            text = (self.folder / folder / name).read_text(encoding="utf-8")
            return [line for line in text.splitlines() if not line.startswith("#")]

        self.assertEqual(rows("held", "rigs.txt"), rows(model, "rigs.txt"))
        self.assertNotEqual(rows("refined", "rigs.txt"), rows(model, "rigs.txt"))
        for folder in ("held", "refined"):
            (frame,) = rows(folder, "frames.txt")
            self.assertTrue(frame.startswith("30 8 "))
            self.assertTrue(frame.endswith(" 2 CAMERA 5 9 CAMERA 3 4"))
            self.assertNotEqual(frame, rows(model, "frames.txt")[0])
        self.refused(USAGE, "convert", model, "out.txt", mentions="rigs and frames")

    def test_outputs_that_cannot_be(self):
        model = self.model()
        for arguments, part in (
            (["absent/out/"], "absent"),
            (["model", "--format", "bal", "--accept-loss"], "folder"),
            (["model/images.txt/", "--format", "colmap_binary"], "images.txt"),
            (["model", "--format", "colmap_binary"], "another folder"),
        ):
            with self.subTest(arguments):
                self.refused(FILE, "convert", model, *arguments, mentions=part)
        self.clba("convert", model, "out", "--format", "stl", exit_code=USAGE)
        for text in ("model/points3D.txt", "model/cameras.txt"):
            (self.folder / text).unlink()
            self.refused(FILE, "convert", model, "out/", mentions=text.split("/")[1])


class Generate(CliTest):
    def read(self, name):
        return (self.folder / name).read_bytes()

    def test_kinds(self):
        for kind in ("hall", "street", "landmark"):
            with self.subTest(kind):
                self.assertRegex(self.clba("info", self.scene(kind=kind)).stdout, r"images +12\n")

    def test_equal_seeds_give_equal_files(self):
        first, again = self.scene(name="a.txt"), self.scene(name="b.txt")
        other = self.scene(seed=8, name="c.txt")
        self.assertEqual(self.read(first), self.read(again))
        self.assertNotEqual(self.read(first), self.read(other))

    def test_compression_by_name(self):
        plain, packed = self.scene(name="a.txt"), self.scene(name="a.txt.gz")
        self.assertEqual(gzip.decompress(self.read(packed)), self.read(plain))
        self.assertTrue(self.read(self.scene(name="a.txt.bz2")).startswith(b"BZh"))

    def test_truth_fits_better_than_the_start(self):
        start = self.scene("--truth", "truth.txt")
        costs = [self.solve(file, "--max-iterations", 0)["initial_cost"]
                 for file in (start, "truth.txt")]
        self.assertGreater(costs[0], 10 * costs[1])

    def test_folder_that_does_not_exist(self):
        self.refused(FILE, "generate", "hall", "-o", "absent/scene.txt", mentions="absent")
        self.refused(FILE, "generate", "hall", "-o", "x.txt", "--truth", "absent/t.txt",
                     mentions="absent")


class Solve(CliTest):
    def test_log_report_and_outputs(self):
        file = self.scene()
        text = self.clba("solve", file, "-o", "out.txt.gz", "--ply", "out.ply",
                         "--json", "summary.json").stdout
        self.assertRegex(text, r"^iter +cost +cost_change +\|gradient\| +\|step\| +tr_ratio +"
                               r"tr_radius +ls_iter +iter_time +total_time\n")
        summary = self.summary()
        self.assertRegex(text, r"(?m)^ *%d +\d\.\d{6}e" % summary["num_iterations"])
        self.assertIn("Termination", text)
        self.assertTrue((self.folder / "out.ply").read_bytes().startswith(b"ply\n"))
        again = self.solve("out.txt.gz", "--max-iterations", 0)
        # The file holds every digit of the state that was measured.
        self.assertAlmostEqual(again["initial_cost"] / summary["final_cost"], 1, delta=1e-9)
        self.assertEqual(sorted(path.name for path in self.folder.iterdir()),
                         ["out.ply", "out.txt.gz", "scene.txt", "summary.json"])

    def test_json(self):
        file = self.scene()
        summary = self.solve(file)
        for field in ("file", "device", "images", "points", "observations", "initial_cost",
                      "final_cost", "reference_final_cost", "termination", "linear_solver",
                      "preconditioner", "precision", "num_iterations", "solve_seconds",
                      "total_seconds", "peak_device_bytes", "iterations"):
            self.assertIn(field, summary)
        self.assertEqual((summary["file"], summary["images"]), (file, 12))
        self.assertEqual(summary["termination"], "convergence")
        rows = summary["iterations"]
        self.assertEqual([row["iteration"] for row in rows], list(range(len(rows))))
        self.assertEqual(len(rows), summary["num_iterations"] + 1)
        self.assertEqual(rows[-1]["cost"], summary["final_cost"])
        for before, row in zip(rows, rows[1:]):
            self.assertLessEqual(row["cost"], before["cost"])
            self.assertGreaterEqual(row["seconds"], before["seconds"])
            for field in ("linear_solver_iterations", "accepted"):
                self.assertIn(field, row)
        self.assertAlmostEqual(summary["reference_final_cost"] / summary["final_cost"], 1,
                               delta=1e-10)

    def test_quiet(self):
        done = self.clba("solve", self.scene(), "--quiet")
        self.assertEqual(done.stdout + done.stderr, "")

    def test_solvers_agree(self):
        file = self.scene()
        costs = {}
        for solver in (["pcg_schur", "--preconditioner", "schur_jacobi"],
                       ["pcg_schur", "--preconditioner", "block_jacobi"],
                       ["pcg_hessian"], ["direct_schur"]):
            for precision in ("double", "mixed"):
                summary = self.solve(file, "--linear-solver", *solver, "--precision", precision,
                                     *CONVERGED)
                self.assertEqual(summary["linear_solver"], solver[0])
                self.assertEqual(summary["precision"], precision)
                costs[" ".join(solver), precision] = summary["reference_final_cost"]
        reference = costs["direct_schur", "double"]
        for how, cost in costs.items():
            self.assertAlmostEqual(cost / reference, 1, delta=1e-7, msg=str(how))

    def test_covariance(self):
        file = self.scene()
        text = self.clba("solve", file, "--covariance", "all.json", "--covariance-points",
                         "--gauge-images", 3, 5, "--variance-factor").stdout
        self.assertRegex(text, r"exact, gauge first_image_and_baseline \(images 3 and 5\)")
        found = self.summary("all.json")
        self.assertEqual((found["gauge_images"], found["num_freedoms"]), ([3, 5], 7))
        self.assertEqual([len(found[block]) for block in ("pose", "center", "intrinsics")],
                         [12, 12, 12])
        self.assertEqual([len(found[block][0]) for block in ("pose", "center", "point")],
                         [21, 6, 6])
        self.assertEqual(found["pose"][3], [0] * 21)
        self.assertGreater(min(found["center"][0][k] for k in (0, 2, 5)), 0)
        self.clba("solve", file, "--covariance", "all.csv", "--covariance-gauge", "inner")
        lines = (self.folder / "all.csv").read_text(encoding="utf-8").splitlines()
        self.assertEqual(lines[0], "block,index,row,column,covariance")
        self.assertEqual(len(lines), 1 + 12 * (21 + 6 + 6))
        self.assertRegex(lines[1], r"^pose,0,0,0,\d")
        self.refused(USAGE, "solve", file, "--quiet", "--covariance", "bad.csv",
                     "--covariance-gauge", "problem", mentions="leaves 7 of the 7")

    def test_verify(self):
        text = self.clba("solve", self.scene(), "--json", "summary.json", "--verify",
                         *CONVERGED).stdout
        self.assertIn("relative difference", text)
        verify = self.summary()["verify"]
        self.assertLess(abs(verify["relative_cost_difference"]), 1e-7)
        self.assertLess(verify["max_center_distance"], 1e-2 * verify["extent"])

    def test_verify_starts_from_the_file_that_the_output_replaces(self):
        file = self.scene()
        self.clba("solve", file, "-o", file, "--json", "summary.json", "--verify")
        self.assertGreater(self.summary()["verify"]["num_iterations"], 1)

    def test_equal_bits_twice(self):
        file = self.scene()
        for name in ("a.txt", "b.txt"):
            self.clba("solve", file, "-o", name, "--quiet")
        self.assertEqual((self.folder / "a.txt").read_bytes(),
                         (self.folder / "b.txt").read_bytes())

    def test_priors(self):
        self.clba("generate", "street", "-o", "scene.txt", "--truth", "truth.txt", "--images", 12,
                  "--observations-per-image", 80)
        # BAL's "R, t, f, k1, k2" of the truth; centres -R^T t.
        rows = (self.folder / "truth.txt").read_text(encoding="utf-8").split()
        images, points, observations = map(int, rows[:3])
        numbers = list(map(float, rows[3 + 4 * observations:]))
        world = numbers[9 * images:]
        gps = ["image, x, y, z, sx, sy, sz", "# centres", ""]
        for i in range(images):
            gps.append(f"{i}, " + ", ".join(map(str, self.center(numbers[9 * i:9 * i + 6]))) +
                       ", 0.01,0.01,0.02")
        gps = self.write("\n".join(gps), "gps.csv")
        control = self.write("".join(f"{p}," + ",".join(map(str, world[3 * p:3 * p + 3])) +
                                     ",0.01,0.01,0.01\r\n" for p in (0, points - 1)), "gcp.csv")
        free = self.solve("scene.txt")
        held = self.solve("scene.txt", "--position-priors", gps, "--point-priors", control, "-o",
                          "out.txt")
        self.assertEqual((free["gauge"], free["num_gauge_freedoms"]), ("free", 7))
        self.assertEqual((held["gauge"], held["num_gauge_freedoms"]), ("fixed_by_priors", 0))
        self.assertEqual(free["final_prior_cost"], 0)
        self.assertGreater(held["initial_prior_cost"], 10 * held["final_prior_cost"])
        self.assertGreater(held["final_prior_cost"], 0)
        self.assertIn("fixed_by_priors", self.clba("solve", "scene.txt", "--point-priors", control,
                                                   "--position-priors", gps).stdout)

    @staticmethod
    def center(pose):
        """-R^T t with R = exp([w]_x): R^T t turns t by -w."""
        w, t = pose[:3], pose[3:]
        angle = math.sqrt(sum(x * x for x in w))
        k = [-x / angle for x in w]
        kt = [k[1] * t[2] - k[2] * t[1], k[2] * t[0] - k[0] * t[2], k[0] * t[1] - k[1] * t[0]]
        along = sum(a * b for a, b in zip(k, t)) * (1 - math.cos(angle))
        return [-(t[i] * math.cos(angle) + kt[i] * math.sin(angle) + k[i] * along)
                for i in range(3)]

    def test_bad_priors(self):
        scene = self.scene()
        for text, mentions in (
                ("", "priors.csv: has no priors"),
                ("0,1,2,3,1,1,1\nx,1,2,3,1,1,1\n", "priors.csv:2: the image is 'x'"),
                ("0,1,2,3,1,1\n", "priors.csv:1: there is no sz"),
                ("0,1,2,3,1,1,1,1\n", "priors.csv:1: there is more"),
                ("0,1,nan,3,1,1,1\n", "priors.csv:1: y is 'nan'"),
                ("0,1,2,3,1,1,0\n", "priors.csv:1: sz is '0'"),
                ("99,1,2,3,1,1,1\n", "priors.csv:1: the index is 99, but there are 12 images"),
                ("-1,1,2,3,1,1,1\n", "priors.csv:1: the index is -1"),
                ("3,1,2,3,1,1,1\n3,1,2,3,1,1,1\n", "images[1] = 3")):
            with self.subTest(text):
                name = self.write(text, "priors.csv")
                self.refused(FILE, "solve", scene, "-o", "out.txt", "--position-priors", name,
                             mentions=mentions)
        self.refused(FILE, "solve", scene, "--point-priors", "absent.csv", mentions="absent.csv")

    def test_priors_by_name_and_in_another_frame(self):
        scene = self.scene(kind="street")
        self.clba("convert", scene, "model/", "--format", "colmap_text", "--accept-loss")
        # A cube's corners and more, far from the scene's frame, for images by their names.
        line = "image{:06d},{},{},{},10,10,10\n".format
        rows = [line(i + 1, 5e5 + 100 * (i % 2), 4e6 + 100 * (i // 2 % 2), 100 + 50 * (i // 4))
                for i in range(8)]
        gps = self.write("\ufeffimage,x,y,z,sx,sy,sz\r\n" + "".join(rows), "gps.csv")
        start = self.clba("solve", "model", "--position-priors", gps, "--max-iterations", 0)
        self.assertIn("gps.csv: camera centres are", start.stderr)
        self.assertIn("--align-to-priors", start.stderr)
        far = self.solve("model", "--position-priors", gps, "--max-iterations", 0)
        near = self.solve("model", "--position-priors", gps, "--max-iterations", 0,
                          "--align-to-priors")
        self.assertLess(near["initial_prior_cost"], 1e-4 * far["initial_prior_cost"])
        # The alignment is a similarity: observations cost what they did.
        self.assertAlmostEqual(near["initial_cost"] - near["initial_prior_cost"],
                               far["initial_cost"] - far["initial_prior_cost"],
                               delta=1e-6 * far["initial_cost"])
        index = self.write("0,0,0,0,1,1,1\n", "one.csv")
        self.refused(USAGE, "solve", "model", "--position-priors", index, "--align-to-priors",
                     mentions="three images")
        twice = (self.folder / "model" / "images.txt").read_text(encoding="utf-8")
        self.write(twice.replace("image000002", "image000001"), "model/images.txt")
        self.refused(FILE, "solve", "model", "--position-priors", gps,
                     mentions="gps.csv:2: several images have the name 'image000001'")

    def test_constant_intrinsics(self):
        file = self.scene()
        self.clba("convert", file, "model/", "--format", "colmap_text", "--accept-loss")

        def cameras(folder):
            lines = (self.folder / folder / "cameras.txt").read_text(encoding="utf-8").splitlines()
            # f, cx, cy, k1, k2 of RADIAL
            return [tuple(map(float, line.split()[4:])) for line in lines if line[0] != "#"]

        before = cameras("model")
        for names, constant in (("cx,cy", (1, 2)), ("f", (0,)), ("all", range(5))):
            with self.subTest(names):
                self.clba("solve", "model", "-o", "out/", "--quiet", "--constant-intrinsics", names)
                for old, new in zip(before, cameras("out"), strict=True):
                    for k in range(5):
                        self.assertEqual(old[k] == new[k], k in constant)
        self.refused(USAGE, "solve", "model", "--constant-intrinsics", "cx,fx",
                     mentions="no camera has a parameter fx")

    def test_pixel_sigma_weighs_observations(self):
        file = self.scene()
        plain = self.solve(file, "--max-iterations", 0)
        half = self.solve(file, "--max-iterations", 0, "--pixel-sigma", 0.5)
        self.assertAlmostEqual(half["initial_cost"], 4 * plain["initial_cost"],
                               delta=1e-9 * half["initial_cost"])

    def test_limits_keep_the_best_state(self):
        file = self.scene()
        summary = self.solve(file, "--max-iterations", 1)
        self.assertEqual((summary["termination"], summary["num_iterations"]), ("no_convergence", 1))
        self.assertLess(summary["final_cost"], summary["initial_cost"])
        summary = self.solve(file, "--time-limit", "1e-9")
        self.assertEqual(summary["reason"], "max_seconds")
        target = 0.5 * summary["initial_cost"]
        summary = self.solve(file, "--target-cost", target)
        self.assertEqual(summary["reason"], "target_cost")
        self.assertLessEqual(summary["final_cost"], target)

    def test_loss_resists_outliers(self):
        file = self.scene("--outliers", "0.05", "--truth", "truth.txt")
        options = ["--loss", "cauchy", "--loss-scale", 2]
        summary = self.solve(file, *options, *CONVERGED)
        truth = self.solve("truth.txt", *options, "--max-iterations", 0)
        self.assertEqual((summary["loss"], summary["loss_scale"]), ("cauchy", 2))
        self.assertLess(summary["final_cost"], truth["initial_cost"])

    def test_no_observations(self):
        file = self.write("1 1 0\n0 0 0 0 0 -5 500 0 0\n1 2 3\n")
        self.refused(FILE, "solve", file, "-o", "out.txt", mentions="observations")

    def test_output_folder_that_does_not_exist(self):
        file = self.scene()
        for option in ("-o", "--ply", "--json"):
            self.refused(FILE, "solve", file, option, "absent/out", mentions="absent")
        for option in ("--ply", "--json"):
            self.refused(FILE, "solve", file, option, ".", mentions="folder")

    def test_kernel_cache_folder(self):
        file = self.scene()
        cache = self.folder / "cache/kernels"
        self.clba("solve", file, "--quiet", CLBA_CACHE_DIR=str(cache))
        self.assertTrue(list(cache.glob("*.clbin")))
        self.clba("solve", file, "--quiet", CLBA_CACHE_DIR="")
        # One that is named must be writable.
        error = self.clba("solve", file, "-o", "out.txt", exit_code=FILE,
                          CLBA_CACHE_DIR=str(self.folder / file / "kernels")).stderr
        self.assertRegex(error, r"\Aclba: error: [^\n]+CLBA_CACHE_DIR[^\n]+\n\Z")
        self.assertFalse((self.folder / "out.txt").exists())
        # The default is not: kernels are compiled each time.
        environment = {**os.environ, "XDG_CACHE_HOME": str(self.folder / file)}
        environment.pop("CLBA_CACHE_DIR", None)
        subprocess.run([CLBA, "solve", file, "--quiet"], cwd=self.folder, check=True,
                       env=environment)

    def test_no_plugin(self):
        file = self.scene()
        error = self.clba("solve", file, "--linear-solver", "direct_schur", "-o", "out.txt",
                          exit_code=NO_DEVICE, CLBA_CHOLMOD="/nonexistent").stderr
        self.assertIn("clba_cholmod", error)
        self.assertFalse((self.folder / "out.txt").exists())

    def test_ctrl_c_keeps_the_best_state(self):
        file = self.scene(images=150, per_image=400)
        command = [CLBA, "solve", file, "-o", "out.txt", "--json", "summary.json", "--verify",
                   "--max-iterations", "100000", "--function-tolerance", "1e-300",
                   "--gradient-tolerance", "1e-300", "--parameter-tolerance", "1e-300"]
        with subprocess.Popen(command, cwd=self.folder, text=True, stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE) as process:
            self.assertTrue(process.stdout.readline().startswith("iter"))
            self.assertIn("0 ", process.stdout.readline())
            process.send_signal(signal.SIGINT)
            process.communicate()
        self.assertEqual(process.returncode, INTERRUPTED)
        summary = self.summary()
        self.assertEqual(summary["termination"], "user_stop")
        self.assertNotIn("verify", summary)
        self.assertIn("images", self.clba("info", "out.txt").stdout)

    @unittest.skipUnless((DATA / "bal").is_dir(), "no real problems in CLBA_TEST_DATA")
    def test_dubrovnik_16(self):
        summary = self.solve(DATA / "bal/problem-16-22106-pre.txt.bz2")
        self.assertEqual((summary["images"], summary["points"], summary["observations"]),
                         (16, 22106, 83718))
        self.assertAlmostEqual(summary["initial_cost"] / 4185659.51825, 1, delta=1e-11)
        self.assertLess(summary["reference_final_cost"], 18033.9034788 * (1 + 1e-3))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
