"""Cameras for photographs without any: points by OpenCV, cameras by COLMAP.

`solve.solve_cameras` finds them, `advice` says how well that went and which photographs to add, and
`capture.solve_capture` makes a capture of the layout `colmap` of them.
"""

from lambent_core.startup import import_colmap

# Before any module of this room does, so that this process keeps its handlers of signals.
import_colmap()
