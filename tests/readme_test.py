# SPDX-License-Identifier: Apache-2.0
"""What README.md shows works: its C program is examples/quickstart.c and runs, its commands run, and
its links lead somewhere."""
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

SOURCE, CLBA, QUICKSTART = (pathlib.Path(argument).resolve() for argument in sys.argv[1:4])
README = (SOURCE / "README.md").read_text(encoding="utf-8")


def block(heading, language):
    """The first block of code in `language` below a heading."""
    below = README.split(f"\n{heading}\n", 1)[1]
    return re.search(rf"^```{language}\n(.*?)^```$", below, re.M | re.S).group(1)


class ReadmeTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def test_c_quickstart_is_the_example(self):
        example = (SOURCE / "examples/quickstart.c").read_text(encoding="utf-8")
        self.assertEqual(block("### From C", "c"), example)

    def test_c_quickstart_runs(self):
        subprocess.run([QUICKSTART], cwd=self.folder, check=True)
        self.assertTrue((self.folder / "quickstart.ply").read_bytes().startswith(b"ply\n"))

    def test_commands_run(self):
        commands = block("### From the command line", "sh")
        path = f"{CLBA.parent}:{os.environ['PATH']}"
        subprocess.run(["bash", "-euxc", commands], cwd=self.folder, check=True,
                       env={**os.environ, "PATH": path})

    def test_links_lead_to_files(self):
        for page in [SOURCE / "README.md", *SOURCE.glob("docs/*.md"),
                     *SOURCE.glob("bindings/*/README.md")]:
            text = page.read_text(encoding="utf-8")
            for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", text):
                self.assertTrue((page.parent / target).exists(), f"{page.name}: {target}")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
