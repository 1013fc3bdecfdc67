"""The asset of a bundle in the formats of other programs: glTF, USD, Wavefront OBJ, Mitsuba, Blender."""
