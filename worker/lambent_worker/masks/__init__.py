"""Where the object is in each picture, when neither alpha nor the layout says it.

`apply.attach_masks` takes a folder of masks, `estimate.estimate_masks` makes one, `segmenter.Segmenter` is
the seam for somebody else's program. A mask is grey: 0 background, 255 object, in the pixels of its picture
file.
"""
