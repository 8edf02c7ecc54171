"""``python -m adaptmg`` is the command ``adaptmg``."""

from adaptmg.cli import main

if __name__ == "__main__":
    main()
