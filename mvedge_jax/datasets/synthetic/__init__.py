"""Synthetic scenes: exact disparity, object ids and occlusion for every view.

A scene is made of solids with procedural textures (`make_world` and `make_scene`; `scene` by name;
`random_scene` by key) and rendered as a light field (`render`) or as posed photographs
(`render_posed`) by a ray caster in JAX. Room: `world` (what a scene consists of).
"""

from ._five import five_views as five_views
from ._make import make_scene as make_scene, make_world as make_world
from ._random import (
    random_light_fields as random_light_fields,
    random_scene as random_scene,
)
from ._render import (
    PosedViews as PosedViews,
    render as render,
    render_posed as render_posed,
    visibility as visibility,
)
from ._render_stored import render_stored as render_stored
from ._scenes import (
    scene as scene,
    scene_names as scene_names,
)
from ._solids import (
    bar as bar,
    box as box,
    plane as plane,
    rotation as rotation,
    sphere as sphere,
)
