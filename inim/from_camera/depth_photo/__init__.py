"""Photographs with depth inside: one file holds the colour picture and its depth.

| module  | what it does                                                                      |
| ------- | --------------------------------------------------------------------------------- |
| `read`  | which kind a file is; colour and depth, upright, and what the depth says          |
| `heif`  | HEIC and HEIF: auxiliary depth images, with Apple's metadata or the codec's own   |
| `jpeg`  | JPEG: dynamic depth (Android), GDepth, and Apple's disparity as a further picture |
| `apple` | what Apple's metadata says of a depth image's codes                               |
| `xmp`   | the metadata's XML, in bounded time, without entities                             |
| `codes` | from whole numbers to distances or disparities                                    |
"""
