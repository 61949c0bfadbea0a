"""Floods and kills the plant's process during a watch's checks: the watch must make all of them.

python3 flood_plant.py PROGRAMS [CYCLES], with the folder of `flankscope` and `flankscope-plant`.
"""

import json
import os
import pathlib
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time

programs = pathlib.Path(sys.argv[1]).resolve()
cycles = sys.argv[2] if len(sys.argv) > 2 else "560"
over = threading.Event()
count = {"pages": 0, "silent connections": 0, "kills": 0}


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def ask_pages(page, token):
    """Asks for one page after the other."""
    paths = ["/board", "/checks", "/trend?tool=demo%20die", "/metrics", "/now"]
    while not over.is_set():
        request = (
            f"GET {random.choice(paths)} HTTP/1.1\r\nHost: 127.0.0.1:{page}\r\n"
            f"Connection: close\r\nAuthorization: Bearer {token}\r\n\r\n"
        )
        try:
            with socket.create_connection(("127.0.0.1", page), 2) as asked:
                asked.settimeout(2)
                asked.sendall(request.encode())
                while asked.recv(65536):
                    pass
            count["pages"] += 1
        except OSError:
            pass
        time.sleep(0.05)


def connect_and_say_nothing(ports):
    held = []
    while not over.is_set():
        try:
            held.append(socket.create_connection(("127.0.0.1", random.choice(ports)), 2))
            count["silent connections"] += 1
        except OSError:
            time.sleep(0.05)
        if len(held) > 400:
            for old in held[:200]:
                old.close()
            held = held[200:]
        time.sleep(0.02)


def never_read(path):
    """Readers of the watch's socket that read nothing."""
    held = []
    while not over.is_set():
        try:
            reader = socket.socket(socket.AF_UNIX)
            reader.connect(path)
            held.append(reader)
            if len(held) > 12:
                held.pop(0).close()
        except OSError:
            pass
        time.sleep(0.3)


def kill_again_and_again(plant, settings, env):
    while not over.is_set():
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen([plant, "serve", settings], env=env, **quiet)
        time.sleep(random.uniform(1, 5))
        process.kill()
        process.wait()
        count["kills"] += 1


with tempfile.TemporaryDirectory() as folder:
    env = dict(os.environ, FLANKSCOPE_STATE=f"{folder}/state")
    plant = str(programs / "flankscope-plant")
    users = f"{folder}/users.toml"
    made = subprocess.run(
        [plant, "token", "flood", "--users", users], env=env, capture_output=True, text=True, check=True
    )
    page, modbus = free_port(), free_port()
    settings = f"{folder}/plant.toml"
    pathlib.Path(settings).write_text(
        f'history = "press.db"\nstale_after_s = 60\n[page]\nlisten = "127.0.0.1:{page}"\nusers = "users.toml"\n'
        f'[modbus]\nlisten = "127.0.0.1:{modbus}"\n'
    )
    history, document = f"{folder}/press.db", f"{folder}/watch.json"
    watch = subprocess.Popen(
        [programs / "flankscope", "watch", "--link", "sim", "--speed", "8", "--every", "1", "--cycles", cycles]
        + ["--teeth", "40", "--quiet", "--history", history, "--json", document],
        env=env,
        stdin=subprocess.DEVNULL,
    )
    jobs = [
        (ask_pages, (page, made.stdout.strip())),
        (ask_pages, (page, made.stdout.strip())),
        (connect_and_say_nothing, ([page, modbus],)),
        (never_read, (history + ".live",)),
        (kill_again_and_again, (plant, settings, env)),
    ]
    threads = [threading.Thread(target=target, args=args) for target, args in jobs]
    for thread in threads:
        thread.start()
    code = watch.wait()
    over.set()
    for thread in threads:
        thread.join()
    checks = json.loads(pathlib.Path(document).read_text())["checks"]
    verdicts = [check["inspection"]["verdict"] for check in checks]
    words = {word: verdicts.count(word) for word in sorted(set(verdicts))}
    print(f"exit code {code}, {len(checks)} checks: {words}; {count}")
    sys.exit(set(verdicts) != {"go"})
