"""Synthetic scenes: exact disparity, object ids and occlusion for every view.

A scene is made of solids with procedural textures (`make_world` and `make_scene`; `scene` by name)
and rendered as a light field (`render`) by a ray caster in JAX. Rooms: `world` (what a scene
consists of), `random_scenes` (scenes drawn from a key).
"""

from ._make import make_scene as make_scene, make_world as make_world
from ._render import render as render, visibility as visibility
from ._scenes import scene as scene, scene_names as scene_names
from ._solids import bar as bar, box as box, plane as plane, rotation as rotation, sphere as sphere
