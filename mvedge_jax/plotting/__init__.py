"""Pictures of light fields, disparity maps and scores: every function returns a figure.

Nothing is shown, saved or registered with pyplot: `figure.savefig(path)` is the caller's choice.
"""

from ._curves import (
    plot_calibration as plot_calibration,
    plot_consistency as plot_consistency,
    plot_precision_recall as plot_precision_recall,
)
from ._light_field import plot_edges as plot_edges, plot_epi as plot_epi, plot_views as plot_views
from ._maps import (
    disparity_limits as disparity_limits,
    plot_comparison as plot_comparison,
    plot_disparity as plot_disparity,
    plot_error as plot_error,
)
from ._superpixels import (
    label_colors as label_colors,
    plot_labels_per_pixel as plot_labels_per_pixel,
    plot_superpixels as plot_superpixels,
    superpixel_frames as superpixel_frames,
    superpixel_picture as superpixel_picture,
)
from ._views import plot_view_maps as plot_view_maps, view_frames as view_frames
