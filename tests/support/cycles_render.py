"""Run by an interpreter that has bpy: opens a bundle with our import script, and renders it with Cycles.

python cycles_render.py SCRIPT BUNDLE ENVIRONMENT VIEW SAMPLES OUTPUT.exr
"""

import runpy
import sys

import bpy

script, bundle, environment, view, samples, output = sys.argv[1:]
sys.argv = ["blender", "--", bundle, "--env", environment, "--view", view]
runpy.run_path(script, run_name="__main__")
scene = bpy.context.scene
scene.cycles.device = "CPU"
scene.cycles.samples = int(samples)
scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
# Nothing is clamped, and a pixel is the mean over its square.
scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0.0
scene.cycles.pixel_filter_type = "BOX"
scene.render.threads_mode, scene.render.threads = "FIXED", 2
scene.render.film_transparent = True
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_mode = "RGBA"
scene.render.image_settings.color_depth = "32"
scene.render.filepath = output
bpy.ops.render.render(write_still=True)
