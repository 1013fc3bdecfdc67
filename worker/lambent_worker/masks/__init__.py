"""Object masks for pictures without alpha or masks in the layout.

`apply.attach_masks` takes a folder of masks, `estimate.estimate_masks` makes one, `segmenter.Segmenter` is
the interface for external segmenters. A mask is grey: 0 background, 255 object, in the pixels of its picture
file.
"""
