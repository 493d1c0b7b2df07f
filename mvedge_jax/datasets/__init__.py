"""Light fields from files and from formulas.

Subpackages: `synthetic` (rendered scenes), `photographs` (posed photographs), `exchange` (formats
    of other tools), `stored` (large light fields, in the bits of their files).
"""

from mvedge_jax._export import register

from . import synthetic as synthetic
from ._columns import columns_of as columns_of
from ._convention import ConventionCheck as ConventionCheck, check_convention as check_convention
from ._dead import find_dead_views as find_dead_views
from ._images import read_raw as read_raw
from ._load import load_ground_truth as load_ground_truth, load_light_field as load_light_field
from ._open import open_source as open_source
from ._pfm import read_pfm as read_pfm, write_pfm as write_pfm
from ._write_hci import write_hci as write_hci

register(__name__)
