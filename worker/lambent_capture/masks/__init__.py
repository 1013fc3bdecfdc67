"""Object masks for pictures without alpha or masks in the layout.

`estimate.estimate_masks` makes masks, `folder.write_masks` writes them, and `segmenter.Segmenter` is the
interface for external segmenters. A mask is grey: 0 background, 255 object, in the pixels of its picture
file.
"""
