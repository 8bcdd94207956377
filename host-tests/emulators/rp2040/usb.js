// A USB host that finds and opens a serial port (CDC ACM) and exchanges bytes with it.
//
// That of rp2040js supports only 64-byte packets on endpoint 0, and sends empty packets to a listening device.
"use strict";

const { createSetupPacket, DataDirection, SetupRecipient, SetupType, SetupRequest } = require("rp2040js");

const CONFIGURATION = 2, HEADER_LEN = 9;
const INTERFACE = 4, ENDPOINT = 5, CDC_DATA = 10, BULK = 2;
const PAUSE_NANOS = 1e6, RECOVERY_NANOS = 10e6;
const SET_CONTROL_LINE_STATE = 0x22, DTR_AND_RTS = 3;

class UsbHost {
    // `take(bytes)` receives the device's data.
    constructor(usb, take) {
        Object.assign(this, { usb, take });
        this.toSend = [];
        // Requested length per endpoint; a device may listen before it is enumerated.
        this.wanted = new Array(16).fill(0);
        this.transfer = null;
        this.next = usb.rp2040.clock.createAlarm(() => this.then(this.received));
        this.endpoints = { in: -1, out: -1 };
        usb.onUSBEnabled = () => usb.resetDevice();
        usb.onResetReceived = () => this.recover(() => this.enumerate());
        usb.onEndpointWrite = (endpoint, bytes) => this.onSent(endpoint, bytes);
        usb.onEndpointRead = (endpoint, len) => this.onListening(endpoint, len);
    }

    // USB 2.0, 7.1.7.5: a device has 10 ms to recover from a reset.
    recover(then) {
        Object.assign(this, { then });
        this.next.schedule(RECOVERY_NANOS);
    }

    enumerate() {
        const { Standard, Class } = SetupType;
        const { SetAddress, GetDescriptor, SetDeviceConfiguration } = SetupRequest;
        const configuration = (len) => [Standard, GetDescriptor, CONFIGURATION << 8, len];
        this.request([Standard, SetAddress, 1], () =>
            this.request(configuration(HEADER_LEN), (header) =>
                this.request(configuration(header[2] | (header[3] << 8)), (descriptors) => {
                    this.endpoints = dataEndpoints(descriptors);
                    this.request([Standard, SetDeviceConfiguration, 1], () =>
                        this.request([Class, SET_CONTROL_LINE_STATE, DTR_AND_RTS], () => this.give()),
                    );
                }),
            ),
        );
    }

    request([type, bRequest, wValue, wLength = 0], then) {
        this.transfer = { wLength, received: [], then };
        this.usb.sendSetupPacket(
            createSetupPacket({
                dataDirection: wLength ? DataDirection.DeviceToHost : DataDirection.HostToDevice,
                type,
                recipient: type === SetupType.Class ? SetupRecipient.Interface : SetupRecipient.Device,
                bRequest,
                wValue,
                wIndex: 0,
                wLength,
            }),
        );
    }

    onSent(endpoint, bytes) {
        if (endpoint === this.endpoints.in) return this.take(bytes);
        const { transfer } = this;
        if (endpoint !== 0 || !transfer) return;
        transfer.received.push(...bytes);
        if (transfer.received.length >= transfer.wLength) {
            this.transfer = null;
            // Completes a read with an empty packet (status stage) before anything else.
            if (transfer.wLength) this.usb.endpointReadDone(0, new Uint8Array(0));
            Object.assign(this, { then: transfer.then, received: transfer.received });
            this.next.schedule(PAUSE_NANOS);
        }
    }

    onListening(endpoint, len) {
        this.wanted[endpoint] = len;
        this.give();
    }

    send(bytes) {
        for (const byte of bytes) this.toSend.push(byte);
        this.give();
    }

    give() {
        const { out } = this.endpoints;
        if (out < 0 || !this.wanted[out] || !this.toSend.length) return;
        this.usb.endpointReadDone(out, Uint8Array.from(this.toSend.splice(0, this.wanted[out])));
        this.wanted[out] = 0;
    }
}

// Returns the bulk endpoints of the data interface.
function dataEndpoints(descriptors) {
    const found = { in: -1, out: -1 };
    let isData = false;
    for (let at = 0; at + 1 < descriptors.length && descriptors[at]; at += descriptors[at]) {
        const type = descriptors[at + 1];
        if (type === INTERFACE) isData = descriptors[at + 5] === CDC_DATA;
        if (type === ENDPOINT && isData && (descriptors[at + 3] & 3) === BULK) {
            found[descriptors[at + 2] & 0x80 ? "in" : "out"] = descriptors[at + 2] & 0xf;
        }
    }
    return found;
}

module.exports = { UsbHost };
