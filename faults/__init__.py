"""What must not go wrong, tried thousands of times: bad input, damaged files, unsafe edges. Nothing imports this.

Each module is a command, ``python -m faults.NAME --record FILE``; `docs/explanation/reliability.md` lists the promises.
"""
