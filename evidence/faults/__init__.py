"""What must not go wrong, tried thousands of times: bad input, damaged files, unsafe edges. Nothing imports this.

Each module is a command, ``python -m evidence.faults.NAME --record FILE``; see `docs/reliability.md`.
"""
