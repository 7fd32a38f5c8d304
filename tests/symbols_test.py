# SPDX-License-Identifier: Apache-2.0
"""The library exports exactly the functions that clba.h declares."""
import re
import subprocess
import sys

nm, library, header = sys.argv[1:]
text = re.sub(r"/\*.*?\*/", "", open(header, encoding="utf-8").read(), flags=re.S)
declared = set(re.findall(r"CLBA_API[^;(]*?\b(clba_\w+)\s*\(", text))
lines = subprocess.run([nm, "-D", "--defined-only", library], check=True, text=True,
                       stdout=subprocess.PIPE).stdout.splitlines()
# Weak symbols are instances of the C++ library's templates.
exported = {line.split()[-1] for line in lines if line.split()[-2] not in "VWu"}
for name in sorted(declared - exported):
    print(f"declared but not exported: {name}")
for name in sorted(exported - declared):
    print(f"exported but not declared: {name}")
sys.exit(declared != exported or not declared)
