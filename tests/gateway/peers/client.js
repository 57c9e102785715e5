// SPDX-FileCopyrightText: 2026 The ros2_deepc authors
// SPDX-License-Identifier: Apache-2.0
//
// node-opcua as client: client.js URL CERTIFICATE_FOLDER USERS NODE..., with USERS as JSON: [[user, password], ...]. An
// empty user is anonymous and unencrypted. Prints one JSON list with, for each user, the values read and the status of
// writing 0.5 to each node.
const opcua = require("node-opcua");
const path = require("path");

async function visit(url, folder, user, password, names) {
    const options = { endpointMustExist: false, connectionStrategy: { maxRetry: 0 }, requestedSessionTimeout: 20000 };
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
    return result;
}

async function main() {
    const [url, folder, users, ...names] = process.argv.slice(2);
    const results = [];
    for (const [user, password] of JSON.parse(users)) results.push(await visit(url, folder, user, password, names));
    console.log(JSON.stringify(results));
    process.exit(0);
}
main();
