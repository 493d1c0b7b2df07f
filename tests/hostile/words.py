"""Command lines that ask for what cannot be: `words | other words | what the error says`.

Every one ends with code 2 and a sentence before anything is compiled, and changes no file. Words in
capitals are files and folders of `_places`.
"""

from pathlib import Path

import numpy as np
from datasets.layouts import random_views, save_image, write_hci
from hostile.case import hostile
from hostile.commands import call, complaint, files
from hostile.scenes import TRUTH, hci

from mvedge_jax.datasets import write_pfm

_LINES = """
info nowhere | depth nowhere OUT | views nowhere OUT | edit nowhere OUT --mask MASK | view nowhere |
    view MAP --scene nowhere | export nowhere OUT --to colmap | superpixels nowhere OUT |
    nowhere is not there; expected a folder or file
info MAP | depth MAP OUT | view MAP --scene MAP | export MAP OUT --to colmap |
    is not a light field that can be read
info SCENE --views 2 | views SCENE OUT --views 2 | view SCENE --html NEW --views 4 |
    superpixels SCENE OUT --views 2 | `views` must be odd, at least 3 and at most the grid of 3x3
eval MAP SCENE --crop -1 | --crop must be at least 0
eval MAP SCENE --crop 1000000000 | --crop must be at least 0 and leave pixels
eval nowhere.pfm SCENE | nowhere.pfm is not there
eval MAP nowhere | edges nowhere OUT | nowhere is not there
eval SCENE MAP | is not there; expected a portable float map (.pfm)
eval SCENE/parameters.cfg SCENE | not a portable float map
eval LARGE SCENE | 10x8 px (width x height), larger than the ground truth
eval MAP BARE | has no ground truth; expected gt_disp_lowres.pfm
eval MAP [bold]x[/red] | [bold]x[/red] is not there
eval MAP SCENE --crop 1 --out SCENE --overwrite | depth SCENE SCENE | export BIG BIG --to colmap |
    edit SCENE SCENE --mask MASK | is the input
eval MAP SCENE --crop 1 --out SCENE/inside --overwrite | depth SCENE SCENE/inside --overwrite |
    batch SCENE SCENE | optimize SCENE SCENE/inside --overwrite | lies in the input
eval MAP SCENE --crop 1 --out PARENT --overwrite | edges SCENE PARENT --overwrite |
    holds the input
eval MAP SCENE --crop 1 --out SCENE/.. --overwrite | holds
depth SCENE . | is or holds the working directory; choose another folder as
depth SCENE LABELS | not empty
depth SCENE OUT --views 4 | demo OUT --views 4 | odd
depth SCENE OUT --preset edges --all-views | needs dense labels, which preset edges does not
depth SCENE OUT --tile 64 --memory 2 | both say how large tiles are
depth SCENE OUT --tile 256 --all-views | there is no --all-views
depth SCENE OUT --memory 2 --scale 0.5 | there is no --scale
depth SCENE OUT --memory 0.1 | `memory` must be at least
depth SCENE OUT --tile 10 | at least twice `overlap`
depth SCENE OUT --set smoothness.color | depth SCENE OUT --set =1 |
    expected PATH=VALUE, such as smoothness.color=0.3
depth SCENE OUT --set smoothness.colour=1 | no path of `EdgeDepth`: the fields of `ColorAndDepth`
depth SCENE OUT --set smoothness.color.more=1 | `smoothness.color.more` is no path of `EdgeDepth`
depth SCENE OUT --set __class__.__name__=1 | --set __class__.__name__: `__class__.__name__` is
depth SCENE OUT --set smoothness=1 | `smoothness` is a part, whose numbers and static fields are
depth SCENE OUT --set searched=1 | holds a tuple; only numbers, words, true and false can be set
depth SCENE OUT --set smoothness.color=blue | `smoothness.color` must be a number, got 'blue'
depth SCENE OUT --set smoothness.color=[red] | --set smoothness.color: `smoothness.color` must
depth SCENE OUT --set smoothness.color=true | `smoothness.color` must be a number, got True
depth SCENE OUT --set smoothness.color=nan | must be finite and not negative, got nan
depth SCENE OUT --set refine.solves=1e400 | --set refine.solves: `refine.solves` must be a whole
depth SCENE OUT --set refine.solves=0 | sweep SCENE OUT --choose refine.solves=0,1 |
    `solves` must be at least 1, got 0
depth SCENE OUT --set solver.by_residual=1 | `solver.by_residual` must be true or false, got 1
depth SCENE OUT --set refine.sharpen.mode=1 | `refine.sharpen.mode` must be a word, got 1
depth SCENE OUT --set dense.trust=1 --preset edges | `dense.trust` is no path of `EdgeDepth`
depth SCENE OUT --set dense=1 --preset edges | `dense` holds None; only numbers
depth SCENE OUT --model nowhere | batch nowhere OUT | there is no such file
depth SCENE OUT --model MAP | learn OUT --model MAP | codec can't decode byte
depth SCENE OUT --model /dev/zero | /dev/zero: there is no such file
depth SCENE OUT --scale 0 | `scale` must be in (0, 1], got 0.0
depth SCENE OUT --scale nan | view SCENE --html NEW --scale nan |
    `scale` must be in (0, 1], got nan
depth SCENE OUT --scale 1e-320 | leaves no pixel of
depth SCENE OUT --range 1 0 | edges SCENE OUT --range 1 -1 | low < high
depth SCENE OUT --range nan nan | depth SCENE OUT --range -inf inf |
    `disparity_range` must be finite with low < high
depth SCENE OUT --max-gb nan | MVEDGE_MAX_GB must be a positive number of gigabytes, got nan
depth SCENE OUT --max-gb much | MVEDGE_MAX_GB must be a positive number of gigabytes, got much
depth SCENE OUT --max-gb 1e-9 | /input_Cam004.png belongs to claims 3x3x6x8x3 numbers, 0.0 GB in
depth EMPTY OUT --set refine.solvse=1 | edges EMPTY OUT --set refine.solvse=1 |
    views EMPTY OUT --set refine.solvse=1 | optimize EMPTY OUT --set refine.solvse=1 |
    learn EMPTY OUT --set refine.solvse=1 | batch EMPTY OUT --set refine.solvse=1 |
    superpixels EMPTY OUT --set refine.solvse=1 | `refine.solvse` is no path of
depth x[/old] OUT | x[/old] is not there
depth /dev/zero OUT | /dev/zero is not there
optimize SCENE OUT --iterations 0 | --iterations must be at least 1, got 0
optimize SCENE OUT --grow-points 3 | --grow-points needs --supervised
optimize SCENE OUT --grow-points -1 | --grow-points must not be negative, got -1
optimize SCENE OUT --features vgg16 | needs --vgg16 FILE
optimize SCENE OUT --features vgg16 --vgg16 nowhere | no file of VGG16 weights
optimize SCENE OUT --features vgg16 --vgg16 MAP | is not an .npz file
optimize SCENE OUT --state nowhere | There is no saved state at
optimize SCENE OUT --state MAP | does not hold a whole state of the optimization in the
optimize SCENE OUT --state /dev/zero | There is no saved state at /dev/zero
learn OUT --what smoothness.colour | no path of `EdgeDepth`: the fields of `Col
learn OUT --what refine.solves | `refine.solves` holds 2; only numbers and arrays can be
learn OUT --rate 0 | --rate must be positive, got 0.0
learn OUT --rate nan | --rate must be positive, got nan
learn OUT --views 4 | `shape` must have odd numbers of view rows and columns, got 4x4
learn OUT --size 0 | render demo OUT --size 0 0 |
    `shape` must be positive integers (view rows, view columns, height
learn OUT --range 1 0 | `disparity_range` must be (low, high), finite with low < high, got
learn OUT --random 0 | `count` must be at least 1, got 0
learn OUT --validation -1 | --validation must not be negative, got -1
learn OUT --size 8 --views 3 --steps 0 | --steps must be at least 1, got 0
learn OUT --size 8 --views 3 --prior nan | `prior` must be finite and not negative, got nan
learn OUT --size 8 --views 3 --limit nan | `limit` must be positive, got nan
learn SCENE OUT --validation 1 | --validation 1 leaves none of 1 scenes to learn from
learn SCENE BARE OUT | has no ground truth to learn from
learn nowhere OUT | sweep nowhere OUT --vary dense.trust=1:2 | there is no such file or folder
edit SCENE OUT | either --insert or --mask
edit SCENE OUT --mask nowhere | edit SCENE OUT --mask LABELS | edit SCENE OUT --insert SCENE |
    could not be read as a picture
edit SCENE OUT --mask MASK --insert MASK | name either --insert or --mask, not both or none
edit SCENE OUT --mask SMALL | must have the size of the views, 8x6 px
edit SCENE OUT --insert SMALL --at nan 1 | --at must be finite, got (nan, 1.0)
edit SCENE OUT --insert SMALL --disparity nan | --disparity must be finite, got nan
edit SCENE OUT --insert SMALL --slant 0 nan | --slant must be finite, got (0.0, nan)
edit SCENE OUT --mask MASK --color 0 2 0 | --color must be three numbers between 0 and 1, got
edit SCENE OUT --mask MASK --color 0 1 | --color {None}|{FLOAT FLOAT FLOAT}
render nothing OUT | must be one of demo, slanted
render demo | OUT
render demo OUT --views 4 | odd numbers of view rows and columns, got 4x4
render demo OUT --vignette 2 | `vignette` must be between 0 and 1, got 2.0
render demo OUT --baseline 0 | `baseline` must be positive and finite, got 0.0
render demo OUT --vignette 0.4 --gain nan | `gain` must be between 0 and 1, got nan
render demo LABELS --overwrite | demo LABELS --overwrite | is not a result of mvedge
demo OUT --views 1 | --views must be
demo OUT --size 3 3 | --size must be
demo OUT --scene moon | moon
demo OUT --set refine.solves=0 | --set refine.solves: `solves` must be at least 1
view | Missing from mvedge view: SCENE|RESULT
view MAP | does not tell its light field; name it: --scene
view MAP --scene SCENE --reference 1 | --reference is for what `stereo` wrote
view SCENE --html MAP | must name a file that ends in .html
view SCENE --html SCENE | --html must name a file that ends in .html, got
view SCENE --html nowhere/page.html | is no folder
view SCENE --html PAGE | is there already
view SCENE --html FOLDER.html | view SCENE --html FOLDER.html --overwrite |
    is a folder; --html must name a file to write
view SCENE --html NEW --quality 0 | `quality` must be between 1 and 100, got 0
view SCENE --html NEW --quality 101 | `quality` must be between 1 and 100, got 101
view SCENE --html NEW --other nowhere | view SCENE --html NEW --other SCENE |
    /disparity.pfm is not there
view SCENE --html NEW --other LARGE | the map of large must have the size of the views, 8x6 px
view SCENE --html NEW --superpixels SCENE | --superpixels needs a RESULT
view MAP --scene SCENE --html NEW --superpixels nowhere | is not there; expected the result of
view MAP --scene SCENE --html NEW --superpixels LABELS | /labels.npy must hold whole numbers of
view SCENE --html NEW --hidden SCENE | --hidden needs a RESULT, with whose map it is shown
view MAP --scene SCENE --html NEW --hidden nowhere |
    views.h5 does not exist; `mvedge views` writes
view SCENE --port -1 | the port must be between 0 and 65535, got -1
view SCENE --port 70000 | the port must be between 0 and 65535, got 70000
view SCENE --host nowhere.invalid | the page cannot be served at nowhere.invalid
view SCENE --host 192.0.2.1 | the page cannot be served at 192.0.2.1, port 8765
export BIG OUT | Missing from mvedge export: --to
export SCENE OUT --to colmap | `images` must be at least 8 px a side, got 6x8
export BIG OUT --to obj | invalid choice 'obj' for argument '--to'
export BIG OUT --to ply | has no depth to make points of; run mvedge depth
export BIG OUT --to ply --points edges | has no edge points; run mvedge depth
export BARE OUT --to colmap | does not know its camera; give its focal length
export BIG MAP --to colmap --overwrite | batch SCENE MAP |
    is a file, expected a folder to write into
export BIG OUT --to colmap --camera 0 1 1 | export BIG OUT --to colmap --camera 1 -1 1 |
    export BIG OUT --to colmap --camera 1 1 nan | --camera must be three finite numbers above 0
batch | sweep SCENE | at least one scene and
batch SCENE | at least one scene and OUT, got 1
batch SCENE SCENE OUT | is given twice
batch SCENE OUT --range 1 0 | --range must be lowest and highest disparity, got (1.0, 0.0)
batch SCENE OUT --range -inf inf | --range must be finite, got (-inf, inf)
batch SCENE OUT --views 4 | --views must be odd and at least 3, got 4
batch SCENE OUT --scale 0 | --scale must be in (0, 1], got 0.0
batch SCENE OUT --workers -1 | --workers must not be negative, got -1
batch SCENE OUT --scheduler nonsense | sweep SCENE OUT --vary dense.trust=1:2 --scheduler nonsense |
    no Dask scheduler answers at nonsense (--scheduler; expected an address such as
batch SCENE OUT --video --scheduler tcp://nowhere:1 | batch SCENE OUT --video --slurm |
    batch SCENE OUT --slurm --workers 1 | --workers or --scheduler exclude each other
sweep SCENE OUT | at least one number or choice
sweep SCENE OUT --vary dense.trust | sweep SCENE OUT --vary dense.trust=1:x |
    expected PATH=LOW:HIGH
sweep SCENE OUT --vary dense.turst=1:2 |
    sweep SCENE OUT --vary dense.turst=1:2 --vary dense.trust=1:2 | `dense.turst` is no path
sweep SCENE OUT --vary refine.solves=1:2 | `refine.solves` is not a number, as an interval
sweep SCENE OUT --vary dense.trust=1:2 --preset edges | `dense.trust` is no path
sweep SCENE OUT --vary dense.trust=1:2 --set refine.solves=0 | --set refine.solves: `solves`
sweep EMPTY OUT --vary dense.trust=1:2 --set refine.solvse=1 | `refine.solvse` is no path
sweep SCENE OUT --vary dense.trust=2:1 | an interval must have finite ends in increasing order
sweep SCENE OUT --vary dense.trust=0:1 | a logarithmic interval must be positive, got 0.0
sweep SCENE OUT --vary dense.trust=1:nan | must be finite
sweep SCENE OUT --choose views | expected PATH=A,B
sweep SCENE OUT --choose nothing=1 | `nothing` is no path of `EdgeDepth`: the fields of
sweep SCENE OUT --choose dense.trust=1,2 | `dense.trust` is a number, not a static field; give
sweep SCENE OUT --vary dense.trust=1:2 --trials 0 | `trials` must be at least 1, got 0
sweep SCENE OUT --vary dense.trust=1:2 --batch 0 | `batch` must be at least 1, got 0
sweep SCENE OUT --vary dense.trust=1:2 --wave 0 | `wave` must be at least 1, got 0
sweep SCENE OUT --vary dense.trust=1:2 --objective best | `objective` must be one of ('mse'
sweep SCENE OUT --vary dense.trust=1:2 --journal SCENE |
    sweep SCENE OUT --vary dense.trust=1:2 --journal MAP |
    must be a journal of Optuna or a new file
sweep SCENE OUT --vary dense.trust=1:2 --workers -1 | --workers must not be negative
stereo nowhere OUT | does not exist
stereo SCENE OUT | holds no posed photographs
stereo MAP OUT | expected 5 per pose: a line of numbers and a 4x4 matrix
stereo SCENE OUT --set edges.spacing=1 | `edges.spacing` is no path of `StereoDepth`
stereo SCENE OUT --set refine.solves=0 | --set refine.solves: `solves` must be at least 1, got 0
stereo SCENE OUT --set refine.solves=1 --method points | --set needs --method dense, got points
superpixels SCENE OUT --size 0 | --size must be between 4 px and the shorter side, 6 px, got 0
superpixels SCENE OUT --count 0 | --count must be at least 1, got 0
superpixels SCENE OUT --size 5 --pick 8 0 | --pick must lie in the center view, 8x6 px
superpixels SCENE OUT --size 5 --pick -1 0 | --pick must lie in the center view, 8x6 px, got
superpixels SCENE OUT --size 5 --color nan 0 0 | --color must be three numbers between 0 and
"""


def _places(folder: Path) -> dict[str, Path]:
    write_pfm(folder / "map.pfm", TRUTH)
    write_pfm(folder / "large.pfm", np.pad(TRUTH, 1))
    save_image(folder / "mask.png", np.full((*TRUTH.shape, 3), 255, np.uint8))
    save_image(folder / "small.png", np.zeros((2, 2, 3), np.uint8))
    (folder / "labels").mkdir()
    np.save(folder / "labels" / "labels.npy", np.zeros((1, 2), np.float32))
    (folder / "folder.html").mkdir()
    (folder / "empty").mkdir()
    (folder / "page.html").write_text("mine")
    scene = hci(folder)
    return {
        "SCENE": scene, "SCENE/inside": scene / "inside", "PARENT": folder,
        "SCENE/..": scene / "..", "EMPTY": folder / "empty",
        "SCENE/parameters.cfg": scene / "parameters.cfg",
        "BIG": write_hci(folder / "big", random_views((3, 3, 16, 16, 3))),
        "BARE": write_hci(folder / "bare", random_views((3, 3, 16, 16, 3)), settings=False),
        "MAP": folder / "map.pfm", "LARGE": folder / "large.pfm", "MASK": folder / "mask.png",
        "SMALL": folder / "small.png", "LABELS": folder / "labels", "PAGE": folder / "page.html",
        "FOLDER.html": folder / "folder.html", "NEW": folder / "new.html", "OUT": folder / "out",
        "nowhere": folder / "nowhere", "nowhere/page.html": folder / "nowhere" / "page.html",
    }  # fmt: skip


_ROWS = [row.split(" | ") for row in _LINES.replace(" |\n    ", " | ").strip().splitlines()]


@hostile("mvedge {}", [(words, message) for *lines, message in _ROWS for words in lines])
def _refused(folder: Path, words: str, message: str) -> None:
    places = _places(folder)
    before = files(folder)
    code, _, error = call(*(places.get(word, word) for word in words.split()))
    assert code == 2, error
    assert message in " ".join(error.split()), error
    assert "Traceback" not in error, error
    if "--help" not in error:  # wrong words are told in a frame of several lines
        complaint(error)
    after = files(folder)
    assert after == before, set(after) ^ set(before)
