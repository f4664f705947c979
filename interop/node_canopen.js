// npm's `canopen` (node-canopen) on a socketcand bus: as a client of our node, or as a node of ours.
//
// node_canopen.js client HOST PORT NODE       prints what it did as JSON
// node_canopen.js server HOST PORT NODE EDS   prints `ready`, serves until it is ended
// node_canopen.js lss HOST PORT 0             prints `ready`, serves LSS until it is ended; prints each
//                                             node-ID that it gets

const Module = require('module');
const net = require('net');

// Its checksums are a native addon that wants a compiler; a block transfer's is this.
function crc16(...args) {
    let crc = 0;
    for (const byte of args[args.length - 1]) {
        crc ^= byte << 8;
        for (let bit = 0; bit < 8; ++bit)
            crc = (crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1) & 0xFFFF;
    }
    return Buffer.from([crc >> 8, crc & 0xFF]);
}
const load = Module._load;
Module._load = (name, ...rest) => (name === 'node-crc' ? { crc: crc16 } : load(name, ...rest));

const { Device, Eds, DataType } = require('canopen');
const [role, host, port, id, file] = process.argv.slice(2);
const node = Number(id);

/** Joins a device to the bus can0 of a socketcand server. */
function join(device) {
    return new Promise((resolve) => {
        const socket = net.connect(Number(port), host);
        const greetings = ['< open can0 >', '< rawmode >'];
        let text = '';
        device.addListener('message', ({ id: cob, data }) => {
            const bytes = [...data].map((byte) => byte.toString(16).padStart(2, '0'));
            socket.write(`< send ${cob.toString(16)} ${bytes.length} ${bytes.join(' ')} >`);
        });
        socket.on('data', (piece) => {
            text += piece;
            for (let end; (end = text.indexOf('>')) >= 0; text = text.slice(end + 1)) {
                const words = text.slice(0, end).trim().split(/\s+/).slice(1);
                if (words[0] === 'hi' || words[0] === 'ok') {
                    if (greetings.length) socket.write(greetings.shift());
                    else resolve(socket);
                } else if (words[0] === 'frame') {
                    const data = Buffer.from(words.slice(3).join(''), 'hex');
                    device.receive({ id: parseInt(words[1], 16), data, len: data.length });
                }
            }
        });
    });
}

async function client() {
    const eds = new Eds();
    eds.addSdoClientParameter(node, 0x600 + node, 0x580 + node);
    const device = new Device({ id: 1, eds, enableLss: false });
    const socket = await join(device);
    device.start();
    device.nmt.startNode(1);
    await new Promise((resolve) => setTimeout(resolve, 200));
    const at = (index, subIndex, more) => (
        { deviceId: node, index, subIndex, timeout: 60000, ...more });
    const did = {};
    const read = (index, more) => device.sdo.upload(at(index, 0, more));
    const write = (index, data, more) => device.sdo.download(at(index, 0, { data, ...more }));
    did.trim = await read(0x2001, { dataType: DataType.INTEGER8 });
    await write(0x2001, 9, { dataType: DataType.INTEGER8 });
    did.trimmed = await read(0x2001, { dataType: DataType.INTEGER8 });
    did.place = (await read(0x2009)).toString();
    const program = Buffer.from(Array.from({ length: 2000 }, (_, n) => 7 * n & 0xFF));
    await write(0x200C, program);
    did.segments = program.equals(await read(0x200C));
    await write(0x200C, program.subarray(100), { blockTransfer: true });
    did.blocks = program.subarray(100).equals(await read(0x200C, { blockTransfer: true }));
    did.refusals = [];
    for (const index of [0x2FFF, 0x200E])
        await read(index).catch((error) => did.refusals.push(error.code));
    await write(0x2001, 11, { dataType: DataType.INTEGER8 })
        .catch((error) => did.refusals.push(error.code));
    device.stop();
    socket.end();
    console.log(JSON.stringify(did));
}

async function server() {
    const eds = Eds.fromFile(file);
    // It serves no SDO that its sheet does not name.
    eds.addSdoServerParameter(0, 0x580 + node, 0x600 + node);
    const device = new Device({ id: node, eds, enableLss: false });
    await join(device);
    device.start();
    console.log('ready');
}

async function lss() {
    const eds = new Eds();
    eds.setIdentity({ vendorId: 0x22, productCode: 0x33, revisionNumber: 0x44, serialNumber: 0x55 });
    const device = new Device({ eds, enableLss: true });
    device.lss.addListener('changeDeviceId', (id) => console.log(id));
    await join(device);
    device.lss.start();
    console.log('ready');
}

({ client, server, lss })[role]();
