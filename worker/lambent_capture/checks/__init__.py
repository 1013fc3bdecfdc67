"""Checks a capture for problems before training: views, pictures, masks, exposure, poses.

`examine.examine_capture` works on a `SceneManifest` and the picture files alone, independent of the layout,
and needs neither torch nor a GPU. Angles are in degrees, directions point from the object to a camera, world
z is up.
"""
