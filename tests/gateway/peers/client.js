// SPDX-FileCopyrightText: 2026 The ros2_deepc authors
// SPDX-License-Identifier: Apache-2.0
//
// node-opcua as client: client.js URL USER PASSWORD CERTIFICATE_FOLDER NODE..., prints one JSON line with the values read
// and the status of writing 0.5 to each node. Without a user: anonymous and unencrypted.
const opcua = require("node-opcua");
const path = require("path");

async function main() {
    const [url, user, password, folder, ...names] = process.argv.slice(2);
    const options = { endpointMustExist: false, connectionStrategy: { maxRetry: 1 }, requestedSessionTimeout: 20000 };
    if (user) {
        options.securityMode = opcua.MessageSecurityMode.SignAndEncrypt;
        options.securityPolicy = opcua.SecurityPolicy.Basic256Sha256;
        options.clientCertificateManager = new opcua.OPCUACertificateManager({
            rootFolder: path.join(folder, "pki"), automaticallyAcceptUnknownCertificate: true,
        });
        options.certificateFile = path.join(folder, "cert.pem");
        options.privateKeyFile = path.join(folder, "key.pem");
        options.applicationUri = "urn:peer:node-opcua";
    }
    const client = opcua.OPCUAClient.create(options);
    const result = {};
    try {
        await client.connect(url);
        const session = await client.createSession(
            user ? { type: opcua.UserTokenType.UserName, userName: user, password } : undefined);
        const namespaces = await session.readNamespaceArray();
        const ids = names.map((name) => {
            const [uri, rest] = name.split(";");
            return `ns=${namespaces.indexOf(uri)};${rest}`;
        });
        const read = await session.read(ids.map((nodeId) => ({ nodeId, attributeId: opcua.AttributeIds.Value })));
        result.values = read.map((value) => value.value.value);
        result.times = read.map((value) => value.sourceTimestamp && value.sourceTimestamp.getTime());
        result.writes = [];
        for (const nodeId of ids) {
            const status = await session.write({
                nodeId, attributeId: opcua.AttributeIds.Value, value: { value: { dataType: "Double", value: 0.5 } },
            }).catch((error) => ({ name: error.message }));
            result.writes.push(status.name);
        }
        await session.close();
    } catch (error) {
        result.error = error.message;
    }
    await client.disconnect().catch(() => undefined);
    console.log(JSON.stringify(result));
    process.exit(0);
}
main();
