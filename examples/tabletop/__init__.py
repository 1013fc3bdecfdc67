"""The suite of phone captures with truth: own shapes, own textures, own lights, path traced.

World of every capture: right-handed, z up, the support's top at z = 0, 1 unit = 10 cm. The object is at
the origin. Cameras are camera-to-world with axes x right, y up, looking along -z.
"""
