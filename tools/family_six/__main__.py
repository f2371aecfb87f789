"""`python -m tools.family_six make --seed S --cases N --out DIR`: cases; `seal`, `--list`, `--describe`.

`python -m tools.family score` scores them.
"""

from tools.family_six import cases, causes, ranges, work
from tools.family_two.__main__ import Family, main

if __name__ == "__main__":
    main(Family("family_six", cases, causes, ranges, work), __doc__)
