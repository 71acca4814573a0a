from .footprint_drives import FootprintDrives as FootprintDrives
