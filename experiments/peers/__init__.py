"""What the package is compared with: the thesis' other ways, baselines, other solvers.

Modules: `kmeans` and `lfsp` (superpixels by k-means, and the thesis' own), `epi_segments` (which
lines of an EPI bound one surface), `thesis_views` and `reprojection` (depth of every view as the
thesis has it, and by moving the centre map alone), `solvers` (conjugate gradients with the thesis'
preconditioner, or with the diagonal).
"""
