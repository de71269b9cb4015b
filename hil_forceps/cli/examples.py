"""An example of each command, shown below its help: a line that can be typed as it is in this project's folder."""

EXAMPLES = {
    "bench": "hil-forceps bench --config configs/paper.yaml --out out/paper",
    "run": "hil-forceps run --rig configs/realistic.yaml --interface socketcan --channel can0 --out out/today",
    "drive": "hil-forceps drive --rig configs/realistic.yaml --serial-pty /tmp/forceps",
    "conformance": "hil-forceps conformance --serial /dev/ttyUSB0 --allow-motion --out out/certificate",
    "decode": "hil-forceps decode out/today/bus.log",
    "diagnose": "hil-forceps diagnose day1.csv day2.csv day3.csv --rig configs/realistic.yaml --out out/diagnosis",
    "trend": "hil-forceps trend logs --rig configs/realistic.yaml --out out/trend",
    "replay": "hil-forceps replay out/today/run.mcap",
    "recover": "hil-forceps recover out/today --out out/recovered.mcap",
    "explain": "hil-forceps explain out/today",
    "import": "hil-forceps import out/today/bus.log --out out/imported",
    "simulate": "hil-forceps simulate configs/realistic.yaml --like day1.csv --out out/simulated",
    "fmu": "hil-forceps fmu --rig configs/realistic.yaml --unit plant --fmi 2 --out out/plant.fmu",
    "init": "hil-forceps init forceps.yaml --motor maxon-ec13-305194 --drive odrive",
    "schema": "hil-forceps schema rig > rig.schema.json",
    "open": "hil-forceps open out/diagnosis",
    "check": "hil-forceps check configs/drives/odrive.yaml",
    "doctor": "hil-forceps doctor --rig configs/realistic.yaml --interface socketcan --channel can0",
    "scan": "hil-forceps scan --interface socketcan --channel can0",
    "info": "hil-forceps info --rig configs/paper.yaml",
}
