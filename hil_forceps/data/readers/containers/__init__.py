"""Tables in containers that others' libraries read (Excel, HDF5, MF4): each in a process of its own, with limits."""
