"""Cameras for photographs without any: points by OpenCV, cameras by COLMAP.

`solve.solve_cameras` finds them, `advice` says how well that went and which photographs to add, and
`capture.solve_capture` makes a capture of the layout `colmap` of them.
"""
