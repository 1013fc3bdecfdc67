"""Run by an interpreter whose usd-core has ComplianceChecker: prints what ARKit's rules find in a file."""

import contextlib
import sys

from pxr import Sdr, Tf, UsdUtils

# The wheels lack the definitions of some shaders; the first question reports that, later ones do not.
with contextlib.suppress(Tf.ErrorException):
    Sdr.Registry().GetNodeNames()
checker = UsdUtils.ComplianceChecker(arkit=True)
checker.CheckCompliance(sys.argv[1])
found = [*checker.GetErrors(), *checker.GetFailedChecks(), *checker.GetWarnings()]
print(*found, f"{len(found)} findings", sep="\n")
