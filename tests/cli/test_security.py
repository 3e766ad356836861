"""SROS 2: two processes of one enclave run at once during a replacement, and nobody without a key hears them.

The keystore has the form that sros2 makes, and is made by openssl. Skipped where the middleware is compiled without
security, as the Fast DDS of the wheels is; run by hand on Cyclone DDS that has it (docs/how-to/middleware-settings.md).
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from itertools import groupby
from pathlib import Path

import pytest

from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.long]

REPLACEMENTS = 10
SCHEMA = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
RULE = "<domains><id_range><min>0</min><max>230</max></id_range></domains>"
GOVERNANCE = f"""<?xml version="1.0" encoding="UTF-8"?>
<dds {SCHEMA}><domain_access_rules><domain_rule>{RULE}
  <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
  <enable_join_access_control>true</enable_join_access_control>
  <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
  <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
  <rtps_protection_kind>SIGN</rtps_protection_kind>
  <topic_access_rules><topic_rule>
    <topic_expression>*</topic_expression>
    <enable_discovery_protection>true</enable_discovery_protection>
    <enable_liveliness_protection>true</enable_liveliness_protection>
    <enable_read_access_control>true</enable_read_access_control>
    <enable_write_access_control>true</enable_write_access_control>
    <metadata_protection_kind>ENCRYPT</metadata_protection_kind>
    <data_protection_kind>ENCRYPT</data_protection_kind>
  </topic_rule></topic_access_rules>
</domain_rule></domain_access_rules></dds>
"""
PERMISSIONS = f"""<?xml version="1.0" encoding="UTF-8"?>
<dds {SCHEMA}><permissions><grant name="ENCLAVE">
  <subject_name>CN=ENCLAVE</subject_name>
  <validity><not_before>2020-01-01T00:00:00</not_before><not_after>2040-01-01T00:00:00</not_after></validity>
  <allow_rule>{RULE}
    <publish><topics><topic>*</topic></topics></publish>
    <subscribe><topics><topic>*</topic></topics></subscribe>
  </allow_rule>
  <default>DENY</default>
</grant></permissions></dds>
"""
SYSTEM = """
system secured
contract Words = std_msgs/msg/String @ 50 Hz
topic /words : Words
component One { ENCLAVE run "python3 talker.py" output out
  functionality talk { produces out  mode normal { guarantee out : Words }  mode degraded { } } }
component Two { ENCLAVE run "python3 talker.py" output out
  functionality talk { produces out  mode normal { guarantee out : Words }  mode degraded { } } }
node talker : One { out -> /words }
"""
TALKER = """
import os
import re
from midstride import Component
from std_msgs.msg import String
comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = 0
def normal():
    global count
    count += 1
    out.write(String(data=f"{os.getpid()} {count}"))
talk.set_normal_mode(normal, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""
LISTENER = """
import signal, sys, rclpy
from std_msgs.msg import String
rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
node, going = rclpy.create_node("listener"), [True]
signal.signal(signal.SIGTERM, lambda *_: going.clear())
node.create_subscription(String, "/words", lambda message: print(message.data, flush=True), 1000)
print("ready", flush=True)
while going:
    rclpy.spin_once(node, timeout_sec=0.1)
"""


def openssl(*words: object) -> None:
    subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True)


def keystore(root: Path, *enclaves: str) -> Path:
    """A keystore whose enclaves may do everything, and that leaves out whoever has no key of it."""
    authority, key = root / "public" / "ca.cert.pem", root / "private" / "ca.key.pem"
    for folder in (authority.parent, key.parent):
        folder.mkdir(parents=True)
    openssl("ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", key)
    openssl("req", "-x509", "-new", "-key", key, "-days", 3650, "-subj", "/CN=authority", "-out", authority)
    for enclave in enclaves:
        folder = root / "enclaves" / enclave.strip("/")
        folder.mkdir(parents=True)
        own, request = folder / "key.pem", folder / "request.pem"
        openssl("ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", own)
        openssl("req", "-new", "-key", own, "-subj", "/CN=" + enclave.replace("/", "\\/"), "-out", request)
        by = ("-CA", authority, "-CAkey", key, "-CAcreateserial", "-days", 3650)
        openssl("x509", "-req", "-in", request, *by, "-out", folder / "cert.pem")
        for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
            shutil.copy(authority, folder / name)
        for name, text in (("governance", GOVERNANCE), ("permissions", PERMISSIONS.replace("ENCLAVE", enclave))):
            plain = folder / f"{name}.xml"
            plain.write_text(text)
            openssl(
                "smime",
                "-sign",
                "-text",
                "-in",
                plain,
                "-out",
                plain.with_suffix(".p7s"),
                "-signer",
                authority,
                "-inkey",
                key,
            )
    return root


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
@pytest.mark.parametrize("stated", ["", 'environment { ROS_SECURITY_ENCLAVE_OVERRIDE = "/talker" }'])
def test_two_processes_of_one_enclave_hand_over(midstride: Midstride, tmp_path: Path, stated: str) -> None:
    unsecured = {name: value for name, value in os.environ.items() if not name.startswith("ROS_SECURITY_")}
    secured = {
        "ROS_SECURITY_KEYSTORE": str(keystore(tmp_path / "keystore", "/robot", "/talker")),
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_ENCLAVE_OVERRIDE": "/robot",
    }
    probe = [sys.executable, "-c", "import rclpy; rclpy.init(); rclpy.create_node('probe')"]
    tried = subprocess.run(probe, env={**unsecured, **secured}, capture_output=True, text=True, check=False)
    if tried.returncode and re.search("have the security libraries|does not have security", tried.stderr):
        pytest.skip("this middleware is compiled without security")
    assert tried.returncode == 0, tried.stderr
    midstride.environment |= secured
    (tmp_path / "talker.py").write_text(TALKER)
    (tmp_path / "secured.stride").write_text(SYSTEM.replace("ENCLAVE", stated))
    up = midstride("up", str(tmp_path / "secured.stride"), "-d")
    assert up.status == 0, up.out + up.err
    listeners = []
    for environment in ({**unsecured, **secured}, unsecured):
        listener = subprocess.Popen(
            [sys.executable, "-c", LISTENER], env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        listeners.append(listener)
    heard: list[list[str]] = []
    try:
        for listener in listeners:
            assert listener.stdout is not None and listener.stdout.readline() == "ready\n"
        assert listeners[0].stdout is not None and listeners[0].stdout.readline()
        for at in range(REPLACEMENTS):
            replaced = midstride("replace", "talker", ("Two", "One")[at % 2], "--yes", "--json").json
            assert replaced["outcome"] == "done", replaced
        time.sleep(1.0)  # for what is under way to the second, which must hear nothing
    finally:
        for listener in listeners:
            listener.terminate()
            heard.append(listener.communicate(timeout=20)[0].splitlines())
    numbers = [tuple(map(int, line.split())) for line in heard[0] if " " in line]
    writers = [[number for _, number in rows] for _, rows in groupby(numbers, key=lambda row: row[0])]
    assert len(writers) == REPLACEMENTS + 1, "each writes once, one after the other"
    assert [row for row in writers if row != list(range(row[0], row[0] + len(row)))] == [], "a number is missing"
    assert heard[1] == [], "a process without a key has heard it"
