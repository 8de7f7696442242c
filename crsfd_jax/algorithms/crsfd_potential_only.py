"""CRSfD without demonstrations in its buffer: they only fit the potential.

A control: what of CRSfD is its shaping, and what the demonstrations that SACfD has as well.
"""

from crsfd_jax.algorithms import crsfd

METHOD = crsfd.METHOD._replace(uses_demos=False)
