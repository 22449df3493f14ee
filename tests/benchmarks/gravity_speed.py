"""What gravity between two bodies costs, by how many neighbouring bodies are computed side by side.

python tests/benchmarks/gravity_speed.py

Every body sums over all others in order, whatever is side by side: the bits are the same. Nanoseconds for every two
bodies are those of a call from Python, the least of some rounds; and seconds to compile the program.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from cases.array_programs import bound, gravity

BODIES, ABREAST = (5, 13, 30, 100, 300, 1000), (1, 4, 8, 16)
INTERACTIONS, ROUNDS = 2_000_000, 7


def main() -> None:
    """Print the table."""
    print(f"{'bodies':>6}  " + "".join(f"{f'{w} abreast':>14}" for w in ABREAST) + f"{'compiled in':>16}")
    for n in BODIES:
        random = np.random.default_rng(n)
        y, p = random.normal(size=3 * n), random.uniform(0.5, 1.5, n)
        calls, seconds, found = [], [], np.zeros((len(ABREAST), 3 * n))
        for abreast, z in zip(ABREAST, found, strict=True):
            begin = time.perf_counter()
            calls.append(bound(gravity(n), abreast=abreast, y=y, p=p, z=z))
            seconds.append(time.perf_counter() - begin)
        least, many = [np.inf] * len(calls), max(1, INTERACTIONS // n**2)
        for _ in range(ROUNDS):  # by turns: other processes disturb all alike
            for k, call in enumerate(calls):
                begin = time.perf_counter()
                for _ in range(many):
                    call()
                least[k] = min(least[k], (time.perf_counter() - begin) / many / (n * (n - 1) / 2))
        assert len(set(map(bytes, found))) == 1
        print(f"{n:6}  " + "".join(f"{1e9 * t:11.2f} ns" for t in least) + f"{max(seconds):14.2f} s")


if __name__ == "__main__":
    main()
