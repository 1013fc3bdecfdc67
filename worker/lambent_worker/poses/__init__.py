"""Cameras for photographs without any: COLMAP's incremental mapper, through the extra `poses`.

`capture.solve_capture` turns a folder of photographs into a capture of the layout `colmap`, and `advice`
suggests which photographs to add if that went badly.
"""
