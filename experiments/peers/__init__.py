"""What the package is compared with: the thesis' other ways, baselines, other solvers.

Modules: `kmeans` and `lfsp` (superpixels by k-means, and the thesis' own), `epi_segments` (which
lines of an EPI bound one surface), `thesis_views` and `reprojection` (depth of every view as the
thesis has it, and by moving the center map alone),
`solvers` (conjugate gradients with the thesis' preconditioner, or with the diagonal),
`least_squares` (Levenberg-Marquardt steps for the losses of the model), `relocation` (depth steps
moved to image edges), `photographs` (rendered photographs, COLMAP's depth maps, free scales),
`printed_consistency` (Eq. 6.9 and 6.10 as printed), `superpixel_scores` (those of the authors'
program), `codec` (a depth map as points and cuts, in a file).
"""
