"""An emulated device in real time: ``BoardProcess`` starts this process."""

from rig.backends.emulated.real_time import main

if __name__ == "__main__":
    main()
