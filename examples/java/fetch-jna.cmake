# SPDX-License-Identifier: Apache-2.0
# cmake -P fetch-jna.cmake: gets JNA (Apache-2.0) from Maven Central as jna.jar in the folder it runs
# in. Does nothing, and needs no network, when the file is there.
set(version 5.19.1)
set(url https://repo1.maven.org/maven2/net/java/dev/jna/jna/${version}/jna-${version}.jar)
file(DOWNLOAD ${url} jna.jar TLS_VERIFY ON
     EXPECTED_HASH SHA256=4fb141dd8ef6b0585ffceea4bc49602fbc6312fa977e2c488794ea3e6aafecae)
